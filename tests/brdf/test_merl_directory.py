import os
from pathlib import Path

import numpy as np
import pytest

from torchbrdf.brdf.merl_directory import MERL_MATERIALS, table_paths, verify


def test_the_hundred_names_are_those_of_the_database(shared_data: Path):
    names = np.load(shared_data / "merl_neural" / "merl_neural.npz")["names"]
    assert sorted(MERL_MATERIALS) == sorted(str(name) for name in names)
    assert len(set(MERL_MATERIALS)) == 100


def test_paths_are_sorted_and_other_files_ignored(tmp_path: Path):
    for name in ("steel.binary", "brass.binary", "readme.txt", "brass.exr"):
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in table_paths(tmp_path)] == ["brass.binary", "steel.binary"]


def test_hidden_files_are_no_tables_and_capitals_are(tmp_path: Path):
    """macOS leaves ._brass.binary beside brass.binary on disks of other systems."""
    for name in ("._brass.binary", ".steel.binary", "brass.BINARY", "nylon.FullBin", "pvc.Binary"):
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in table_paths(tmp_path)] == ["brass.BINARY", "nylon.FullBin", "pvc.Binary"]


class TestOneFolderDown:
    def test_the_only_folder_that_holds_tables(self, tmp_path: Path):
        for folder, name in (("brdfs", "brass.binary"), ("code", "BRDFRead.cpp"), ("__MACOSX", "._brass.binary")):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / name).write_bytes(b"")
        (tmp_path / ".hidden").mkdir()
        (tmp_path / ".hidden" / "steel.binary").write_bytes(b"")
        assert table_paths(tmp_path) == [tmp_path / "brdfs" / "brass.binary"]

    def test_several_are_named(self, tmp_path: Path):
        for folder in ("a", "b"):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / "brass.binary").write_bytes(b"")
        with pytest.raises(ValueError, match=r"2 folders in it hold MERL \*\.binary files; name one: ") as raised:
            table_paths(tmp_path)
        assert str(raised.value).endswith(f"{tmp_path / 'a'}, {tmp_path / 'b'}")

    def test_tables_of_the_folder_itself_come_first(self, tmp_path: Path):
        (tmp_path / "brdfs").mkdir()
        for path in (tmp_path / "steel.binary", tmp_path / "brdfs" / "brass.binary"):
            path.write_bytes(b"")
        assert table_paths(tmp_path) == [tmp_path / "steel.binary"]


@pytest.mark.parametrize("second", ["brass.BINARY", "brass.fullbin"])
def test_two_tables_of_one_name(tmp_path: Path, second: str):
    if (tmp_path / "x").touch() or (tmp_path / "X").exists():
        pytest.skip("this file system does not tell capitals")
    for name in ("brass.binary", second):
        (tmp_path / name).write_bytes(b"")
    first, last = sorted(["brass.binary", second])
    with pytest.raises(ValueError, match=f": {first} and {last} are of one name; keep one of them$"):
        table_paths(tmp_path)


@pytest.mark.parametrize("read", [table_paths, verify])
def test_absent_and_empty_directories(tmp_path: Path, read):
    with pytest.raises(FileNotFoundError, match=r"gone: no such directory; expected a folder of MERL \*\.binary"):
        read(tmp_path / "gone")
    with pytest.raises(ValueError, match=r"holds no materials; expected MERL \*\.binary files, found nothing$"):
        read(tmp_path)
    (tmp_path / "brass.binary").write_bytes(b"")
    with pytest.raises(NotADirectoryError, match=r"brass\.binary: is a file; expected a folder of MERL"):
        read(tmp_path / "brass.binary")


def test_what_lies_there_instead_of_tables_is_said(tmp_path: Path):
    for name in ("a.exr", "b.exr", "merl.zip", "README", "._brass.binary"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "code").mkdir()
    with pytest.raises(ValueError, match="holds no materials") as raised:
        table_paths(tmp_path)
    assert str(raised.value).endswith(
        "found 2 .exr, 1 file without suffix, 1 folder, 1 .zip, 1 *.binary whose names begin with a dot"
    )


def test_verify_says_what_is_sound_what_is_wrong_and_what_is_missing(merl_directory: Path, tmp_path: Path):
    sound = merl_directory / "white.binary"
    os.link(sound, tmp_path / "brass.binary")
    os.link(sound, tmp_path / "my-own-paint.binary")
    whole = sound.read_bytes()
    (tmp_path / "chrome.binary").write_bytes(whole[:-8])
    (tmp_path / "nylon.binary").write_bytes(whole + b"\0")
    (tmp_path / "steel.binary").write_bytes(np.array([180, 90, 90], "<i4").tobytes() + whole[12:])
    (tmp_path / "teflon.binary").write_bytes(whole[:12] + np.array([np.nan], "<f8").tobytes() + whole[20:])
    (tmp_path / "pvc.binary").mkdir()
    (tmp_path / "._brass.binary").write_bytes(b"\0\5\x16\7")
    report = verify(tmp_path)
    assert report.folder == tmp_path
    assert set(report.sound) == {"brass", "my-own-paint"}
    assert set(report.unsound) == {"chrome", "nylon", "steel", "teflon", "pvc"}
    assert "truncated" in report.unsound["chrome"]
    assert "oversized" in report.unsound["nylon"]
    assert "(180, 90, 90)" in report.unsound["steel"]
    assert "1 cells of the table are NaN or infinite" in report.unsound["teflon"]
    assert all("\n" not in reason for reason in report.unsound.values())
    assert len(report.missing) == 100 - 6
    assert "alum-bronze" in report.missing
    assert not {"brass", "chrome", "steel"} & set(report.missing)


def test_verify_calls_a_table_without_one_measured_cell_unsound(tmp_path: Path):
    blank = np.array([90, 90, 180], "<i4").tobytes() + np.full(3 * 1458000, -1.0, "<f8").tobytes()
    (tmp_path / "nickel.binary").write_bytes(blank)
    report = verify(tmp_path)
    assert report.sound == ()
    assert "measured" in report.unsound["nickel"]
