import errno
import os
import re
from pathlib import Path

import pytest

from torchbrdf.files import cache_folder, existing_file, writing

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
