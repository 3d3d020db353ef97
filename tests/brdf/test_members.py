from pathlib import Path

import pytest

from torchbrdf.brdf.members import library_members


def touched(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")


def test_folders_and_files_of_several_formats(tmp_path: Path):
    touched(tmp_path / "a" / "brass.binary", tmp_path / "a" / "felt.bsdf", tmp_path / "steel.binary")
    members = library_members([tmp_path / "a", tmp_path / "steel.binary"])
    assert [member.name for member in members] == ["brass", "felt", "steel"]


def test_names_that_clash_are_kept_apart_by_their_folders_and_others_stay_short(tmp_path: Path):
    touched(tmp_path / "a" / "brass.binary", tmp_path / "b" / "brass.bsdf", tmp_path / "b" / "steel.binary")
    assert [m.name for m in library_members([tmp_path / "a", tmp_path / "b"])] == ["a/brass", "b/brass", "steel"]


def test_as_many_folders_as_it_takes(tmp_path: Path):
    touched(tmp_path / "x" / "own" / "brass.binary", tmp_path / "y" / "own" / "brass.binary")
    names = [m.name for m in library_members([tmp_path / "x" / "own", tmp_path / "y" / "own"])]
    assert names == ["x/own/brass", "y/own/brass"]


def test_the_embedded_library_among_files(tmp_path: Path):
    touched(tmp_path / "own" / "brass.binary")
    members = library_members(["default", tmp_path / "own", "default"], ["brass", "steel"])
    assert [(m.name, m.path is None) for m in members] == [
        ("default/brass", True), ("steel", True), ("own/brass", False)
    ]  # fmt: skip


def test_results_of_fits_are_named_after_their_folders(tmp_path: Path):
    touched(tmp_path / "fits" / "ball" / "brdf.binary", tmp_path / "fits" / "cup" / "brdf.binary")
    assert [m.name for m in library_members([tmp_path / "fits" / "ball"])] == ["ball"]
    assert [m.name for m in library_members([tmp_path / "fits"])] == ["ball", "cup"]


def test_a_file_named_twice_counts_once(tmp_path: Path):
    touched(tmp_path / "brass.binary")
    with pytest.warns(UserWarning, match=r"brass\.binary: the same file as .*brass\.binary, which counts once"):
        assert len(library_members([tmp_path, tmp_path / "brass.binary"])) == 1


def test_two_formats_of_one_name_in_one_folder_are_refused(tmp_path: Path):
    touched(tmp_path / "brass.binary", tmp_path / "brass.bsdf")
    with pytest.raises(ValueError, match=r"brass\.binary and .*brass\.bsdf: are of one name in one folder"):
        library_members([tmp_path / "brass.binary", tmp_path / "brass.bsdf"])


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("gone", FileNotFoundError, "gone: no such file or directory; expected a measured table"),
        ("photo.exr", ValueError, r"photo\.exr: no measured table by its suffix; a library takes \.binary"),
        ("empty", ValueError, "empty: holds no materials; expected MERL"),
    ],
)
def test_bad_input(tmp_path: Path, name: str, error: type[Exception], message: str):
    touched(tmp_path / "photo.exr")
    (tmp_path / "empty").mkdir()
    with pytest.raises(error, match=message):
        library_members([tmp_path / name])


def test_nothing(tmp_path: Path):
    with pytest.raises(ValueError, match="a library needs files, got none"):
        library_members([])
