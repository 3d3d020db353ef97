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
        ("gone", FileNotFoundError, "gone: no such file; expected a measured table"),
        ("photo.exr", ValueError, r"photo\.exr: no measured table by its suffix; a library takes \.binary"),
        ("empty", ValueError, "empty: holds no materials; expected MERL"),
    ],
)
def test_bad_input(tmp_path: Path, name: str, error: type[Exception], message: str):
    touched(tmp_path / "photo.exr")
    (tmp_path / "empty").mkdir()
    with pytest.raises(error, match=message):
        library_members([tmp_path / name])


def test_a_link_to_nothing_is_said_to_be_one(tmp_path: Path):
    (tmp_path / "brass.binary").symlink_to("gone.binary")
    with pytest.raises(FileNotFoundError, match=r"brass\.binary: a link to gone\.binary, which does not exist"):
        library_members([tmp_path / "brass.binary"])


def test_a_file_and_a_link_to_it_count_once(tmp_path: Path):
    touched(tmp_path / "brass.binary")
    (tmp_path / "messing.binary").symlink_to("brass.binary")
    with pytest.warns(UserWarning, match=r"messing\.binary: the same file as .*brass\.binary, which counts once"):
        assert [m.name for m in library_members([tmp_path])] == ["brass"]


def test_a_folder_called_as_the_embedded_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Is named by a path."""
    touched(tmp_path / "default" / "brass.binary")
    monkeypatch.chdir(tmp_path)
    found = library_members(["default", "./default"], ["brass"])
    assert [(m.name, m.kind) for m in found][:1] == [("default/brass", "embedded")]
    assert [m.path for m in found] == [None, Path("default/brass.binary")]


def test_names_with_spaces(tmp_path: Path):
    touched(tmp_path / "my own paints" / "sky blue.binary")
    assert [m.name for m in library_members([tmp_path / "my own paints"])] == ["sky blue"]


def test_one_path_in_the_place_of_several(tmp_path: Path):
    touched(tmp_path / "brass.binary")
    assert [m.name for m in library_members(str(tmp_path / "brass.binary"))] == ["brass"]


@pytest.mark.parametrize(
    ("name", "kind"), [("x/brass.binary", "MERL"), ("x/felt.BSDF", "RGL"), ("mug/brdf.binary", "fit")]
)
def test_kinds(tmp_path: Path, name: str, kind: str):
    touched(tmp_path / name)
    assert [m.kind for m in library_members([tmp_path / name])] == [kind]


def test_nothing(tmp_path: Path):
    with pytest.raises(ValueError, match="a library needs files, got none"):
        library_members([])
