import os
from pathlib import Path

import numpy as np
import pytest

from torchbrdf.brdf.merl_directory import MERL_MATERIALS, table_paths


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


def test_absent_and_empty_directories(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"gone: no such directory; expected a folder of MERL \*\.binary"):
        table_paths(tmp_path / "gone")
    with pytest.raises(ValueError, match=r"holds no materials; expected MERL \*\.binary files, found nothing$"):
        table_paths(tmp_path)
    (tmp_path / "brass.binary").write_bytes(b"")
    with pytest.raises(NotADirectoryError, match=r"brass\.binary: is a file; expected a folder of MERL"):
        table_paths(tmp_path / "brass.binary")


def test_what_lies_there_instead_of_tables_is_said(tmp_path: Path):
    for name in ("a.exr", "b.exr", "merl.zip", "README", "._brass.binary"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "code").mkdir()
    with pytest.raises(ValueError, match="holds no materials") as raised:
        table_paths(tmp_path)
    assert str(raised.value).endswith(
        "found 2 .exr, 1 file without suffix, 1 folder, 1 .zip, 1 *.binary whose names begin with a dot"
    )


def result(folder: Path) -> Path:
    """What `fit --uncertainty` leaves in a folder."""
    folder.mkdir(parents=True)
    for name in ("brdf.binary", "brdf_std.binary", "weights.json"):
        (folder / name).write_bytes(b"")
    return folder


def test_of_a_result_it_is_the_brdf_alone(tmp_path: Path):
    assert table_paths(result(tmp_path / "mug")) == [tmp_path / "mug" / "brdf.binary"]


def test_results_of_several_photographs(tmp_path: Path):
    """And none that is being written."""
    for name in ("mug", "cup", ".cup.5f3a"):
        result(tmp_path / name)
    assert [path.parent.name for path in table_paths(tmp_path)] == ["cup", "mug"]


def test_results_and_tables_in_folders_of_one_are_several(tmp_path: Path):
    result(tmp_path / "mug")
    (tmp_path / "merl").mkdir()
    (tmp_path / "merl" / "brass.binary").write_bytes(b"")
    with pytest.raises(ValueError, match="2 folders in it hold MERL"):
        table_paths(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_folder_that_must_not_be_read(tmp_path: Path):
    (tmp_path / "locked").mkdir(mode=0o000)
    with pytest.raises(PermissionError, match="locked: no permission to read this folder; change that"):
        table_paths(tmp_path / "locked")
