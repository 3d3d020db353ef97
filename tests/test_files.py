import os
from pathlib import Path

import pytest

from torchbrdf.files import cache_folder, writing


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
