import errno
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from safetensors.torch import save_file

from failures import fails
from torchbrdf import MerlTable, files, write_image
from torchbrdf.files import (
    FullDiskError,
    being_written,
    cache_folder,
    did_you_mean,
    existing_file,
    remove_unfinished,
    replacing_folder,
    writing,
    writing_folder,
)

TABLE = "a MERL .binary table"
LFS_POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 34992012\n"
STAND_INS = [
    (LFS_POINTER, "is a Git LFS pointer; `git lfs pull`"),
    (b"/annex/objects/SHA256E-s34992012--4d7a.binary\n", "is a git-annex pointer; `git annex get`"),
    (b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X        ", "(AppleDouble), not the file itself"),
    (b"<!DOCTYPE html>\n<html><body>404 Not Found", "is a web page, as downloads that failed leave"),
    (b"\xef\xbb\xbf \r\n<HTML lang=en>", "is a web page"),
    (b"<!-- cached -->\n<html>", "is a web page"),
    (b'<?xml version="1.0"?>\n<Error><Code>AccessDenied</Code></Error>', "is a web page"),
    (b"", "is empty (0 bytes); expected a MERL .binary table"),
]


@pytest.mark.parametrize(("content", "said"), STAND_INS)
def test_what_lies_in_the_place_of_a_file_is_named(tmp_path: Path, content: bytes, said: str):
    path = tmp_path / "brass.binary"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=re.escape(f"{path}: ")) as raised:
        existing_file(path, TABLE)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "content", [b"ply\n", b"\x93NUMPY", b"v 0 0 0\n", b'<?xml version="1.0"?><COLLADA>', b"<!---->" * 200]
)
def test_any_other_file_passes(tmp_path: Path, content: bytes, must_end: None):
    (tmp_path / "x").write_bytes(content)
    assert existing_file(str(tmp_path / "x"), "anything") == tmp_path / "x"


@pytest.mark.parametrize("name", ["gone.binary", "file/below.binary"])
def test_a_file_that_is_missing(tmp_path: Path, name: str):
    (tmp_path / "file").write_bytes(b"x")
    with pytest.raises(FileNotFoundError) as raised:
        existing_file(tmp_path / name, TABLE)
    assert str(raised.value) == f"{tmp_path / name}: no such file; expected a MERL .binary table"


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("phto.exr", "photo.exr"),
        ("Photo.hdr", "photo.exr"),
        ("photo.pn", "photo.png"),
        ("reslt", "result"),
        ("probe.exr", None),  # its suffix alone is like that of others
    ],
)
def test_a_file_that_is_misspelt(tmp_path: Path, name: str, meant: str | None):
    for other in ("photo.exr", "photo.png", ".photo.tmp.exr", "ball.exr"):
        (tmp_path / other).write_bytes(b"x")
    (tmp_path / "result").mkdir()
    with pytest.raises(FileNotFoundError) as raised:
        existing_file(tmp_path / name, "an image")
    told = "" if meant is None else f" (did you mean {meant}?)"
    assert str(raised.value) == f"{tmp_path / name}: no such file{told}; expected an image"


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("gold", "gold-paint or two-layer-gold or gold-metallic-paint"),  # the shortest first, and no more than three
        ("steel", "chrome-steel"),  # though teal has more of its letters
        ("brass", "own/brass"),
        ("chrme-steel", "chrome-steel"),
        ("Metal", "gold-metallic-paint"),
        ("nt", None),
        ("", None),
    ],
)
def test_a_name_that_holds_the_word_is_meant(word: str, meant: str | None):
    names = [f"gold-metallic-paint{i}" for i in ("", 2, 3)] + ["gold-paint", "two-layer-gold", "teal", "chrome-steel"]
    assert did_you_mean(word, [*names, "own/brass"]) == ("" if meant is None else f" (did you mean {meant}?)")


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("elsewhere.binary", "a link to elsewhere.binary, which does not exist; expected"),
        (
            ".git/annex/objects/x",
            "a git-annex link to a file that is not here, which `git annex get` fetches; expected",
        ),
    ],
)
def test_a_link_to_nothing(tmp_path: Path, target: str, said: str):
    (tmp_path / "brass.binary").symlink_to(target)
    with pytest.raises(FileNotFoundError) as raised:
        existing_file(tmp_path / "brass.binary", TABLE)
    assert said in str(raised.value)


def test_a_folder_in_the_place_of_a_file(tmp_path: Path):
    with pytest.raises(IsADirectoryError) as raised:
        existing_file(tmp_path, TABLE)
    assert str(raised.value) == f"{tmp_path}: is a folder; expected a MERL .binary table"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_is_not_waited_for(tmp_path: Path, must_end: None):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="is a pipe or a device; expected a MERL"):
        existing_file(tmp_path / "pipe", TABLE)


def test_a_file_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(path: object, *_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    (tmp_path / "x").touch()
    monkeypatch.setattr("builtins.open", refuse)
    with pytest.raises(PermissionError) as raised:
        existing_file(tmp_path / "x", TABLE)
    assert str(raised.value).startswith(f"{tmp_path / 'x'}: no permission to read it; ")


def write_half(path: Path, error: type[BaseException]) -> None:
    with writing(path) as temporary:
        temporary.write_bytes(b"half")
        raise error


def test_output_appears_whole_under_its_name(tmp_path: Path):
    path = tmp_path / "out.exr"
    with writing(path) as temporary:
        assert temporary.suffix == ".exr"
        assert temporary.parent == tmp_path, "a rename is atomic within one file system only"
        temporary.write_bytes(b"whole")
        assert not path.exists()
    assert path.read_bytes() == b"whole"
    assert os.listdir(tmp_path) == ["out.exr"]


@pytest.mark.parametrize("error", [ValueError, OSError, KeyboardInterrupt, SystemExit])
def test_failure_leaves_nothing(tmp_path: Path, error: type[BaseException]):
    with pytest.raises(error):
        write_half(tmp_path / "out.exr", error)
    assert os.listdir(tmp_path) == []


def test_failure_keeps_what_was_there(tmp_path: Path):
    path = tmp_path / "out.exr"
    path.write_bytes(b"before")
    with pytest.raises(KeyboardInterrupt):
        write_half(path, KeyboardInterrupt)
    assert path.read_bytes() == b"before"
    assert os.listdir(tmp_path) == ["out.exr"]


def test_success_replaces_what_was_there(tmp_path: Path):
    path = tmp_path / "out.exr"
    path.write_bytes(b"before, and longer")
    with writing(path) as temporary:
        temporary.write_bytes(b"after")
    assert path.read_bytes() == b"after"


def test_permissions_are_those_of_any_new_file(tmp_path: Path):
    """Not the 0600 of a temporary file."""
    (tmp_path / "plain").touch()
    with writing(tmp_path / "out") as temporary:
        temporary.touch()
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("file", "a file has this name"),
        ("file/below/out", "{}/file is a file, no folder"),
    ],
)
def test_what_hinders_a_folder(tmp_path: Path, name: str, why: str):
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError) as raised, writing_folder(tmp_path / name):
        pytest.fail("the block must not run")
    assert raised.value.strerror == f"cannot write here ({why.format(tmp_path)}); choose another folder"


def test_what_hinders_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The system says "No such file or directory" of both."""
    gone = tmp_path / "gone"
    with pytest.raises(FileNotFoundError, match=f"there is no folder {gone}"), writing(gone / "x"):
        pytest.fail("the block must not run")

    def refuse(*_: object) -> None:  # as /proc does
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(FileNotFoundError, match=f"{tmp_path} takes no new files"), writing(tmp_path / "x"):
        pytest.fail("the block must not run")


def test_folder_that_does_not_exist(tmp_path: Path):
    with (
        pytest.raises(FileNotFoundError, match=r"cannot write here .*; choose another folder.*out\.exr"),
        writing(tmp_path / "gone" / "out.exr"),
    ):
        pytest.fail("the block must not run")


def test_folder_that_is_a_file(tmp_path: Path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(NotADirectoryError, match=r"cannot write here .*; choose another folder"),
        writing(tmp_path / "file" / "out.exr"),
    ):
        pytest.fail("the block must not run")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="permissions do not bind root")
def test_folder_that_must_not_be_written(tmp_path: Path):
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    with pytest.raises(PermissionError, match="cannot write here"), writing(folder / "out.exr"):
        pytest.fail("the block must not run")


def test_name_that_is_a_folder_leaves_nothing_behind(tmp_path: Path):
    (tmp_path / "out").mkdir()
    with pytest.raises(OSError, match="out"), writing(tmp_path / "out") as temporary:
        temporary.write_bytes(b"whole")
    assert os.listdir(tmp_path) == ["out"]


def test_cache_folder_follows_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "here"))
    assert cache_folder() == tmp_path / "here"
    monkeypatch.setenv("TORCHBRDF_CACHE", "~/there")
    assert cache_folder() == Path.home() / "there"
    monkeypatch.setenv("TORCHBRDF_CACHE", "")
    assert "torchbrdf" in str(cache_folder())
    monkeypatch.delenv("TORCHBRDF_CACHE")
    assert cache_folder().is_absolute()
    assert "torchbrdf" in str(cache_folder())


def test_tests_do_not_use_the_users_cache(own_cache: Path):
    assert cache_folder() == own_cache


class TestFolders:
    def test_files_move_beside_those_that_are_there(self, tmp_path: Path):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "old").touch()
        with writing_folder(tmp_path / "out") as temporary:
            (temporary / "new").touch()
        assert sorted(os.listdir(tmp_path / "out")) == ["new", "old"]
        assert os.listdir(tmp_path) == ["out"]

    def test_what_is_obsolete_goes_where_it_is_not_written_anew(self, tmp_path: Path):
        (tmp_path / "out").mkdir()
        for name in ("old", "new", "mine"):
            (tmp_path / "out" / name).write_text("before")
        with writing_folder(tmp_path / "out", obsolete=["old", "new", "never"]) as temporary:
            (temporary / "new").write_text("after")
        assert {path.name: path.read_text() for path in (tmp_path / "out").iterdir()} == {
            "new": "after", "mine": "before"
        }  # fmt: skip

    def test_the_last_file_is_there_with_all_others_only(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "last").write_text("before")
        seen: list[list[str]] = []
        replace = os.replace

        def watched(source: Path, target: Path) -> None:
            seen.append(sorted(os.listdir(tmp_path / "out")))
            replace(source, target)

        monkeypatch.setattr("os.replace", watched)
        with writing_folder(tmp_path / "out", last="last") as temporary:
            for name in ("z", "last", "a"):
                (temporary / name).write_text("after")
        assert seen == [[], ["a"], ["a", "z"]]
        assert (tmp_path / "out" / "last").read_text() == "after"

    def test_files_move_under_the_lock(self, tmp_path: Path):
        events: list[object] = []

        @contextmanager
        def lock() -> Iterator[None]:
            events.append(os.listdir(tmp_path / "out"))
            yield
            events.append(os.listdir(tmp_path / "out"))

        (tmp_path / "out").mkdir()
        with writing_folder(tmp_path / "out", lock=lock()) as temporary:
            (temporary / "new").touch()
            assert events == []
        assert events == [[], ["new"]]

    def test_a_folder_is_replaced_as_a_whole(self, tmp_path: Path):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "old").touch()
        with replacing_folder(tmp_path / "out", "") as temporary:
            (temporary / "new").touch()
        assert os.listdir(tmp_path / "out") == ["new"]
        assert os.listdir(tmp_path) == ["out"]

    @pytest.mark.parametrize("write", [writing_folder, lambda path: replacing_folder(path, "")])
    def test_failure_leaves_nothing(self, tmp_path: Path, write):
        def fail() -> None:
            with write(tmp_path / "out") as temporary:
                (temporary / "half").touch()
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fail()
        assert os.listdir(tmp_path) == []


def test_what_an_interrupted_clean_up_left_is_removed_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def interrupted(_: Path) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(files, "_remove", interrupted)
        with pytest.raises(KeyboardInterrupt):
            write_half(tmp_path / "out.exr", ValueError)
    assert len(os.listdir(tmp_path)) == 1
    remove_unfinished(being_written())
    assert len(os.listdir(tmp_path)) == 1
    remove_unfinished()
    assert os.listdir(tmp_path) == []


class TestFullDisk:
    """Simulated by errors as writers raise them; `TestTinyDisk` fills a real one where it may."""

    FULL = OSError(errno.ENOSPC, "No space left on device")

    def refused(self, path: Path, error: Exception, left: int | None = None) -> FullDiskError:
        def fail() -> None:
            with writing(path) as temporary:
                temporary.write_bytes(b"half")
                raise error

        with pytest.MonkeyPatch.context() as patch:
            if left is not None:
                patch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=left))
            with pytest.raises(FullDiskError) as raised:
                fail()
        assert os.listdir(path.parent) == []
        return raised.value

    @pytest.mark.parametrize(
        ("error", "left"),
        [
            (FULL, None),
            (type("SafetensorError", (Exception,), {})("I/O error: No space left on device (os error 28)"), None),
            (OSError("Not enough free space to write 34992000 bytes after offset 12"), None),
            (OSError("1458000 requested and 4096 written"), 0),
            (RuntimeError("Error writing image file"), 4096),
        ],
        ids=["system", "safetensors", "numpy before", "numpy meanwhile", "OpenEXR"],
    )
    def test_the_file_and_the_disk_are_named(self, tmp_path: Path, error: Exception, left: int | None):
        path = tmp_path / "out.exr"
        found = self.refused(path, error, left)
        assert (found.errno, found.filename) == (errno.ENOSPC, str(path))
        mount = next(str(folder) for folder in path.parents if os.path.ismount(folder))
        assert found.strerror == (
            f"cannot be written to the disk at {mount}: it is full; make room there, or choose another folder"
        )

    def test_a_quota(self, tmp_path: Path):
        found = self.refused(tmp_path / "out.exr", OSError(errno.EDQUOT, "Disk quota exceeded"))
        assert ": your quota is used up; make room there" in found.strerror

    @pytest.mark.parametrize("error", [ValueError("the ball is black"), FileNotFoundError(errno.ENOENT, "no", "x.exr")])
    def test_bad_input_stays_bad_input(self, tmp_path: Path, error: Exception, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=0))
        with pytest.raises(type(error)) as raised, writing(tmp_path / "out.exr"):
            raise error
        assert raised.value is error

    def test_errors_without_a_reason_stay_where_there_is_room(self, tmp_path: Path):
        with pytest.raises(RuntimeError, match="no such operator"), writing(tmp_path / "out.exr"):
            raise RuntimeError("no such operator")

    def test_a_writer_within_a_writer_is_named_as_the_outer(self, tmp_path: Path):
        def fail() -> None:
            with writing(tmp_path / "x.exr") as outer, writing(outer):
                raise self.FULL

        with pytest.raises(FullDiskError) as raised:
            fail()
        assert raised.value.filename == str(tmp_path / "x.exr")

    def test_a_file_of_a_folder_is_named_where_it_was_to_be(self, tmp_path: Path):
        def fail() -> None:
            with writing_folder(tmp_path / "out") as folder, writing(folder / "brdf.binary"):
                raise self.FULL

        with pytest.raises(FullDiskError) as raised:
            fail()
        assert raised.value.filename == str(tmp_path / "out" / "brdf.binary")
        assert os.listdir(tmp_path) == []

    def test_another_file_on_another_disk_is_named_itself(self, tmp_path: Path):
        def fail() -> None:
            with writing(tmp_path / "out.exr"):
                raise OSError(errno.ENOSPC, "No space left on device", "/dev/shm/other")

        with pytest.raises(FullDiskError) as raised:
            fail()
        assert raised.value.filename == "/dev/shm/other"


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """1 MB, mounted for one test."""
    folder = tmp_path / "tiny"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def _table(path: Path) -> None:
    MerlTable.from_function(lambda w_i, w_o: torch.full_like(w_i, 0.1)).save(path)


def _image(path: Path) -> None:
    write_image(path, torch.rand(3, 600, 600))


def _tensors(path: Path) -> None:
    with writing(path) as temporary:
        save_file({"x": torch.zeros(10**6)}, temporary)


def _page(path: Path) -> None:
    with writing(path) as temporary:
        temporary.write_text("x" * 2 * 10**6)


class TestTinyDisk:
    @pytest.mark.parametrize(
        ("name", "write"),
        [
            ("x.binary", _table),
            ("x.exr", _image),
            ("x.hdr", _image),
            ("x.png", _image),
            ("x.safetensors", _tensors),
            ("x.html", _page),
        ],
    )
    def test_every_writer_names_it_and_leaves_nothing(self, tiny_disk: Path, name: str, write: Callable[[Path], None]):
        with pytest.raises(FullDiskError) as raised:
            write(tiny_disk / name)
        assert raised.value.filename == str(tiny_disk / name)
        assert f"to the disk at {tiny_disk}: it is full" in raised.value.strerror
        assert os.listdir(tiny_disk) == []

    def test_a_command_ends_in_one_line(self, tiny_disk: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path):
        _table(tmp_path / "grey.binary")
        out = tiny_disk / "scene"
        line = fails(capsys, "export", tmp_path / "grey.binary", "--probe", "default", "--size", 8, "-o", out)
        assert f" error: {out / 'brdf.binary'}: cannot be written to the disk at {tiny_disk}: it is full" in line
        assert os.listdir(tiny_disk) == []


@pytest.mark.parametrize(
    ("text", "line"), [("a\n\x1b[31mb", r"a\n\x1b[31mb"), ("ü 1 'x'", "ü 1 'x'"), ("\x7f\u2028", r"\x7f\u2028")]
)
def test_what_does_not_print_is_escaped(text: str, line: str):
    assert files.printable(text) == line
