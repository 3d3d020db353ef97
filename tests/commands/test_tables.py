"""Tables as users bring them: every command takes and refuses the same ones, with the same words."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch

import torchbrdf as tb
from failures import fails
from torchbrdf.cli import main
from torchbrdf.commands._inputs import open_table
from torchbrdf.images import read_picture

LFS_POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 34992012\n"
BAD = {
    "nan": (np.nan, "2 cells of the table are NaN or infinite; the file is damaged: download"),
    "inf": (np.inf, "2 cells of the table are NaN or infinite; the file is damaged: download"),
    "1e300": (1e300, "2 cells of the table exceed 1e+11 1/sr, up to 6.7e+296, which no BRDF can"),
    "pointer": (None, "is a Git LFS pointer; `git lfs pull` in its repository fetches the file itself"),
}


@pytest.fixture(scope="module", params=BAD)
def bad(request: pytest.FixtureRequest, merl_directory: Path, tmp_path_factory: pytest.TempPathFactory):
    """A folder of eight tables, the first of them bad, and what is said of that one."""
    value, said = BAD[request.param]
    folder = tmp_path_factory.mktemp("library")
    for path in merl_directory.iterdir():
        os.link(path, folder / path.name)
    path = folder / "a.binary"
    os.rename(folder / "red.binary", path)
    content = LFS_POINTER
    if value is not None:
        raw = path.read_bytes()
        content = raw[:12] + np.array([value] * 2).tobytes() + raw[28:]
    path.unlink()
    path.write_bytes(content)
    return path, said


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    tb.write_image(tmp_path / "photo.exr", torch.rand(3, 16, 16))
    return tmp_path / "photo.exr"


class TestBadTables:
    @pytest.mark.parametrize("command", ["render", "compare", "analytic", "export"])
    def test_commands_that_take_one(self, capsys, tmp_path: Path, bad: tuple[Path, str], command: str):
        path, said = bad
        given = (path.parent / "white.binary", path) if command == "compare" else (path,)
        output = tmp_path / {"render": "x.exr", "compare": "x.html", "analytic": "x.json", "export": "x"}[command]
        probe = () if command == "analytic" else ("--probe", "default")
        line = fails(capsys, command, *given, *probe, "-o", output)
        assert line.startswith(f"torchbrdf: error: {path}: {said}")
        assert list(tmp_path.iterdir()) == []

    def test_library_of_fit(self, capsys, tmp_path: Path, bad: tuple[Path, str], photo: Path):
        path, said = bad
        library = ("--library", str(path.parent))
        assert main(["fit", str(photo), "--probe", "default", *library, "-o", str(tmp_path / "out")]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        (line,) = (line for line in captured.err.splitlines() if "warning:" not in line)
        assert line.startswith(f"torchbrdf: error: {path}: {said}")
        assert [found.name for found in tmp_path.iterdir()] == ["photo.exr"]

    def test_verify(self, capsys, bad: tuple[Path, str], tmp_path: Path):
        path, said = bad
        for name in ("a", "white"):
            os.link(path.with_stem(name), tmp_path / f"{name}.binary")
        assert main(["verify", str(tmp_path)]) == 2
        lines = capsys.readouterr().out.splitlines()
        assert lines[0] == "1 sound: white"
        assert lines[1].startswith(f"unsound a: {tmp_path / 'a.binary'}: {said}")


def test_verify_says_where_it_looked(capsys, merl_directory: Path, tmp_path: Path):
    (tmp_path / "brdfs").mkdir()
    os.link(merl_directory / "white.binary", tmp_path / "brdfs" / "brass.BINARY")
    assert main(["verify", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines()[:2] == [f"in {tmp_path / 'brdfs'}:", "1 sound: brass"]


class TestFolderOfFit:
    """In the place of the table in it."""

    @pytest.fixture
    def folder(self, merl_directory: Path, tmp_path: Path) -> Path:
        (tmp_path / "fitted").mkdir()
        os.link(merl_directory / "white.binary", tmp_path / "fitted" / "brdf.binary")
        return tmp_path / "fitted"

    def test_render(self, folder: Path, tmp_path: Path):
        common = ("--probe", "default", "--size", "8", "--samples", "16", "-o")
        assert main(["render", str(folder), *common, str(tmp_path / "folder.exr")]) == 0
        assert main(["render", str(folder / "brdf.binary"), *common, str(tmp_path / "file.exr")]) == 0
        assert torch.equal(tb.read_image(tmp_path / "folder.exr"), tb.read_image(tmp_path / "file.exr"))

    def test_export(self, folder: Path, tmp_path: Path):
        assert main(["export", str(folder), "--probe", "default", "--size", "8", "-o", str(tmp_path / "scene")]) == 0
        written = tb.MerlTable.open(tmp_path / "scene" / "brdf.binary")
        assert torch.equal(written.values, tb.MerlTable.open(folder / "brdf.binary").values)

    @pytest.mark.parametrize("command", ["render", "export"])
    def test_another_folder(self, capsys, tmp_path: Path, command: str):
        (tmp_path / "other").mkdir()
        line = fails(capsys, command, tmp_path / "other", "--probe", "default", "-o", tmp_path / "x.exr")
        assert line.endswith("other: no brdf.binary in this folder; name a MERL table or a folder of `torchbrdf fit`")


@pytest.fixture(scope="module")
def library(merl_directory: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Seven tables in a folder, and one beside it."""
    folder = tmp_path_factory.mktemp("mixture")
    (folder / "my tables").mkdir()
    *seven, last = sorted(merl_directory.iterdir())
    for path in seven:
        os.link(path, folder / "my tables" / path.name)
    os.link(last, folder / "another.binary")
    return ["--library", str(folder / "my tables"), "--library", str(folder / "another.binary")]


class TestMixture:
    """Of a folder and a file beside it, as `--library`."""

    def test_classes(self, capsys, library: list[str]):
        assert main(["classes", *library]) == 0
        assert "another" in capsys.readouterr().out

    def test_a_photograph_after_it(self, capsys, library: list[str], photo: Path, tmp_path: Path):
        output = tmp_path / "mug"
        assert main(["fit", *library, str(photo), "--probe", "default", "--no-report", "-o", str(output)]) == 0
        assert (output / "brdf.binary").is_file()

    def test_a_result_joins(self, capsys, library: list[str], merl_directory: Path, tmp_path: Path):
        (tmp_path / "mug").mkdir()
        for name in ("brdf.binary", "brdf_std.binary"):
            os.link(merl_directory / "red.binary", tmp_path / "mug" / name)
        assert main(["classes", *library, "--library", str(tmp_path / "mug")]) == 0
        captured = capsys.readouterr()
        assert "mug" in captured.out
        assert "brdf_std" not in captured.out
        assert "twice in this library, where it counts twice: red and mug; leave one out" in captured.err


class TestPrimariesOfAResult:
    """A table of `fit --primaries` holds a factor of the light for each of those channels; it was taken as Rec. 709."""

    @pytest.fixture
    def result(self, merl_directory: Path, tmp_path: Path) -> Path:
        (tmp_path / "wide").mkdir()
        os.link(merl_directory / "white.binary", tmp_path / "wide" / "brdf.binary")
        (tmp_path / "wide" / "weights.json").write_text('{"primaries": "aces-ap0"}')
        return tmp_path / "wide"

    @pytest.mark.parametrize("file", ["", "brdf.binary"])
    @pytest.mark.parametrize(
        ("command", "output"),
        [("render", "x.exr"), ("compare", "x.html"), ("analytic", "x.gltf"), ("export", "x"), ("convert", "x.bsdf")],
    )
    def test_it_is_not_taken_in_others(
        self, capsys, result: Path, merl_directory: Path, command: str, output: str, file: str
    ):
        given = result / file
        more = (merl_directory / "white.binary",) if command == "compare" else ()
        probe = ("--probe", "default") if command in ("render", "export") else ()
        out = result.parent / output
        line = fails(capsys, command, given, *more, *probe, "-o", out)
        assert f"{given}: its table is in aces-ap0 (`fit --primaries`), and is taken in rec709 here; " in line
        again = "fit the photograph again with --primaries rec709"
        assert line.endswith(again if command == "convert" else f"give --primaries aces-ap0, or {again}")
        assert not out.exists()

    def test_it_is_lit_in_its_own(self, result: Path, tmp_path: Path):
        given = ("render", str(result), "--probe", "default", "--primaries", "aces-ap0", "--size", "8")
        assert main([*given, "-o", str(tmp_path / "x.exr")]) == 0
        assert read_picture(tmp_path / "x.exr").about == ("aces-ap0 to rec709",)

    def test_nor_is_one_in_rec709_taken_in_others(self, capsys, result: Path, tmp_path: Path):
        (result / "weights.json").write_text('{"primaries": "rec709"}')
        given = ("render", str(result), "--probe", "default", "--size", "8", "-o", str(tmp_path / "x.exr"))
        assert "its table is in rec709" in fails(capsys, *given, "--primaries", "xyz")
        assert main([*given]) == 0

    @pytest.mark.parametrize("content", ["", "[]", '{"primaries": 3}', "{}"])
    def test_what_says_nothing_is_taken_as_given(self, result: Path, content: str):
        (result / "weights.json").write_text(content)
        assert open_table(result).valid.any()

    def test_files_of_materials_are_in_rec709(self, capsys, result: Path, tmp_path: Path):
        line = fails(capsys, "analytic", result, "--primaries", "aces-ap0", "-o", tmp_path / "x.gltf")
        assert "x.gltf: a material's file is in rec709, and --primaries is aces-ap0; fit the photograph again" in line

    def test_a_library_warns_of_it(self, capsys, library: list[str], result: Path):
        assert main(["classes", *library, "--library", str(result)]) == 0
        said = f"{result / 'brdf.binary'}: its table is in aces-ap0, and this library is taken in rec709"
        assert said in capsys.readouterr().err
        assert main(["classes", *library, "--library", str(result), "--without", "wide"]) == 0
        assert "aces-ap0" not in capsys.readouterr().err
