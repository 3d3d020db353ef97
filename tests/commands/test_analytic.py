"""`torchbrdf analytic`: what it prints and writes, and how it fails; `torchbrdf fit --uncertainty`."""

import json
import re
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

import torchbrdf as tb
from failures import fails
from fits import BRASS
from materials import lambert
from torchbrdf.analytic.table_fit import fit_analytic
from torchbrdf.brdf.merl import CHANNEL_SCALE, GRID, N_CELLS, above_horizon
from torchbrdf.cli import main
from torchbrdf.mitsuba_startup import mitsuba_program
from torchbrdf.report.grade import GRADES
from torchbrdf.report.report import Verdict

ALBEDO = (0.6, 0.3, 0.1)


@pytest.fixture(scope="module", autouse=True)
def coarsely() -> Iterator[None]:
    """Fits look at fewer cells than usual, and previews take fewer samples: what is said of them is the same."""
    with pytest.MonkeyPatch.context() as patch:
        for name, steps in {"_STEPS": (2, 9, 22), "_ALL": (3, 6, 12)}.items():
            patch.setattr(f"torchbrdf.analytic.table_fit.{name}", steps)
        patch.setattr("torchbrdf.commands._analytic_files._SAMPLES", 64)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tables")


@pytest.fixture(scope="module")
def clay(folder: Path) -> Path:
    """A Lambertian table."""
    tb.MerlTable.from_function(lambert(*ALBEDO)).save(folder / "clay.binary")
    return folder / "clay.binary"


@pytest.fixture(scope="module")
def brass(folder: Path) -> Path:
    """A table of metallic-roughness."""
    BRASS.table.save(folder / "brass.binary")
    return folder / "brass.binary"


@pytest.fixture(scope="module")
def light(folder: Path) -> Path:
    radiance = 10 ** (2 * torch.rand(3, 16, 32, generator=torch.Generator().manual_seed(0)))
    tb.LightProbe(radiance).save(folder / "light.exr")
    return folder / "light.exr"


def stored(path: Path, values: np.ndarray) -> Path:
    """A file in MERL format of (3, N_CELLS) numbers as they are."""
    with open(path, "wb") as file:
        np.array(GRID, "<i4").tofile(file)
        values.astype("<f8").tofile(file)
    return path


def grey_cells() -> np.ndarray:
    """(3, N_CELLS): 0.1 / sr."""
    return np.full((3, N_CELLS), 0.1) / np.array(CHANNEL_SCALE)[:, None]


def run(capsys, *arguments: object) -> tuple[list[str], list[str]]:
    """A command that succeeds: its lines, and those of stderr that are ours."""
    assert main(["analytic", *map(str, arguments)]) == 0
    captured = capsys.readouterr()
    warned = [line for line in captured.err.splitlines() if "torch.jit" not in line]
    return captured.out.splitlines(), warned


def assert_fails(capsys, tmp_path: Path, *arguments: object) -> str:
    before = sorted(tmp_path.rglob("*"))
    line = fails(capsys, "analytic", *arguments)
    assert sorted(tmp_path.rglob("*")) == before, "a failed command left something behind"
    return line.removeprefix("torchbrdf: error: ")


def test_prints_and_writes_what_was_fitted(capsys, tmp_path, brass):
    lines, warned = run(capsys, brass, "--model", "metallic-roughness", "-o", tmp_path / "x.gltf")
    assert warned == []
    assert lines[0].startswith("metallic-roughness: base_color 0.9 0.6 0.2, metallic 0.75, roughness 0.3; relative err")
    assert lines[0].endswith("% (cube-root)")
    assert "iterations" in lines[1]
    assert lines[2:] == [f"wrote {tmp_path / 'x.gltf'}"]
    (material,) = json.loads((tmp_path / "x.gltf").read_text())["materials"]
    assert material["name"] == "brass"
    surface = material["pbrMetallicRoughness"]
    assert surface["baseColorFactor"] == pytest.approx([0.9, 0.6, 0.2, 1], abs=1e-3)
    assert surface["metallicFactor"] == pytest.approx(0.75, abs=1e-3)
    assert surface["roughnessFactor"] == pytest.approx(0.3, abs=1e-3)


def test_another_model_is_said_to_be_another(capsys, tmp_path, brass):
    """Both are printed, with errors in one metric, and the file holds the one that it can."""
    out = tmp_path / "x.mtlx"
    lines, _ = run(capsys, brass, "--model", "lambert", "--metric", "log", "-o", out)
    lambertian, notice, held = (i for i, line in enumerate(lines) if not line.startswith((" ", "wrote", "note: ")))
    assert lines[lambertian].startswith("lambert: diffuse ")
    assert lines[lambertian].endswith("% (log)")
    assert lines[notice] == f"materialx has no such model; {out} holds metallic-roughness, fitted to the same table:"
    assert lines[held].startswith("metallic-roughness: base_color 0.9 0.6 0.2, metallic 0.75, roughness 0.3; rel")
    assert lines[held].endswith("% (log)")
    assert lines[-1].startswith("note: standard_surface takes the exact F of an index of 1.5")
    assert "metallic-roughness" in out.read_text()
    assert "lambert" not in out.read_text()


@pytest.mark.parametrize(
    ("name", "model"),
    [("x.glb", "metallic-roughness"), ("x.xml", "principled"), ("x.mtlx", "metallic-roughness"), ("x.binary", "ggx")],
)
def test_without_a_model_that_of_the_file_is_fitted_alone(capsys, tmp_path, clay, name, model):
    lines, _ = run(capsys, clay, "--most-evaluations", 2, "-o", tmp_path / name)
    assert [line.split(":")[0] for line in lines if "relative error" in line] == [model]


def test_the_line_that_mitsubas_own_program_needs(capsys, tmp_path, clay):
    lines, _ = run(capsys, clay, "--most-evaluations", 1, "-o", tmp_path / "x.xml")
    assert lines[-1] == f"`{mitsuba_program(tmp_path / 'x.xml')}` renders it"
    lines, _ = run(capsys, clay, "--most-evaluations", 1, "-o", tmp_path / "x.json")
    assert lines[-1].startswith("wrote ")


def test_separate_channels_need_another_fit(capsys, tmp_path, brass):
    quick = ("--model", "metallic-roughness", "--separate", "--most-evaluations", "3")
    lines, _ = run(capsys, brass, *quick, "-o", tmp_path / "x.glb")
    shared = "metallic-roughness with parameters shared by the channels"
    assert f"gltf has no such model; {tmp_path / 'x.glb'} holds {shared}, fitted to the same table:" in lines
    lines, _ = run(capsys, brass, *quick, "-o", tmp_path / "x.binary")
    assert not any("holds" in line for line in lines), "a table holds any model"


def test_only_print(capsys, tmp_path, clay, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines, warned = run(capsys, clay, "--model", "lambert")
    assert lines[0].startswith("lambert: diffuse 0.6 0.3 0.1; relative error 0.00%")
    assert warned == []
    assert list(tmp_path.iterdir()) == []


def test_table_and_preview(capsys, tmp_path, clay):
    """A fit that is exact: both spheres are the same picture, and the table is the table."""
    white = tmp_path / "white.exr"
    tb.write_image(white, torch.ones(3, 8, 16))
    files = ("-o", tmp_path / "x.binary", "--preview", tmp_path / "x.exr", "--probe", white, "--size", 20)
    lines, _ = run(capsys, clay, "--model", "lambert", *files)
    shown = f"wrote {tmp_path / 'x.exr'}: from left to right clay, lambert"
    assert lines[-2:] == [f"wrote {tmp_path / 'x.binary'}", shown]
    written, given = (tb.MerlTable.open(path).filled for path in (tmp_path / "x.binary", clay))
    torch.testing.assert_close(written, given, rtol=1e-5, atol=1e-7)
    image = tb.read_image(tmp_path / "x.exr")
    assert image.shape == (3, 20, 40)
    torch.testing.assert_close(image[:, :, :20], image[:, :, 20:], rtol=1e-4, atol=1e-6)
    assert image[:, 10, 10].tolist() == pytest.approx(ALBEDO, rel=0.02)


def test_preview_shows_what_the_file_holds_too(capsys, tmp_path, brass, light):
    files = ("-o", tmp_path / "x.glb", "--preview", tmp_path / "x.png", "--size", 16, "--probe", light)
    run(capsys, brass, "--model", "lambert", "--most-evaluations", 2, *files)
    assert (tmp_path / "x.png").read_bytes()[16:24] == struct.pack(">II", 3 * 16, 16)


def test_preview_that_fails_leaves_no_file(capsys, tmp_path, clay, monkeypatch):
    """Neither is written unless both are."""

    def fail(*_: object) -> None:
        raise ValueError("no light")

    monkeypatch.setattr("torchbrdf.commands._analytic_files.render_tables", fail)
    files = ("-o", tmp_path / "x.binary", "--preview", tmp_path / "x.png")
    assert main(["analytic", str(clay), "--model", "lambert", *map(str, files)]) == 2
    assert "torchbrdf: error: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_bounds_and_failure_to_converge_are_said(capsys, tmp_path, clay, brass):
    lines, warned = run(capsys, brass, "--model", "metallic-roughness", "--most-evaluations", 1)
    assert lines[0].endswith("; NOT CONVERGED")
    (warning,) = warned
    assert warning.startswith("torchbrdf: warning: brass, metallic-roughness: not converged after 1 evaluations; raise")
    lines, _ = run(capsys, clay, "--model", "metallic-roughness")
    assert "  at a bound: metallic at its lower bound 0" in lines


def test_a_model_that_cannot_show_the_material_is_said_to_be_poor(capsys, clay, brass):
    (note,) = [line for line in run(capsys, brass, "--model", "lambert")[0] if line.startswith("note: ")]
    assert re.match(r"note: lambert is \d\d% off, so no parameters of it show this material well; another --", note)
    assert not [line for line in run(capsys, clay, "--model", "lambert")[0] if line.startswith("note: ")]


def test_table_with_holes(capsys, tmp_path):
    cells = grey_cells()
    cells[:, : N_CELLS // 4] = -1
    lines, warned = run(capsys, stored(tmp_path / "holes.binary", cells), "--model", "lambert")
    assert lines[0].startswith("lambert: diffuse 0.3142 0.3142 0.3142; relative error 0.00%")
    missing = above_horizon().ravel()[: N_CELLS // 4].sum() / above_horizon().sum()
    assert warned == [
        f"torchbrdf: warning: holes, lambert: {missing:.0%} of the cells above the horizon were not measured; "
        "the fit extrapolates there"
    ]


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (np.inf, "1 cells of the table are NaN or infinite"),
        (np.nan, "1 cells of the table are NaN or infinite"),
        (None, "f_r is zero in every measured cell; there is nothing to fit"),
    ],
)
def test_tables_that_are_none(capsys, tmp_path, cell, message):
    cells = grey_cells()
    cells[0, 50] = cell or 0
    path = stored(tmp_path / "bad.binary", cells if cell else 0 * cells)
    line = assert_fails(capsys, tmp_path, path, "--model", "lambert", "-o", tmp_path / "x.glb")
    assert line.startswith(f"{path}: ")
    assert message in line


def test_inputs_that_are_not_there(capsys, tmp_path):
    out = ("-o", tmp_path / "x.glb")
    missing = tmp_path / "nowhere.binary"
    line = assert_fails(capsys, tmp_path, missing, *out)
    assert line == f"{missing}: no such file; expected a MERL .binary table"
    line = assert_fails(capsys, tmp_path, tmp_path / "result", *out)
    assert line == f"{tmp_path / 'result'}: no such file; expected a MERL table or a folder of `torchbrdf fit`"
    (tmp_path / "empty").mkdir()
    line = assert_fails(capsys, tmp_path, tmp_path / "empty", *out)
    assert line.startswith(f"{tmp_path / 'empty'}: no brdf.binary in this folder; name a MERL table or a folder")
    (tmp_path / "notes.binary").write_text("these are notes, not a table")
    line = assert_fails(capsys, tmp_path, tmp_path / "notes.binary", *out)
    assert line.startswith(f"{tmp_path / 'notes.binary'}: not a MERL table: the header must be (90, 90, 180), got")


def test_options_that_do_not_fit(capsys, tmp_path, clay):
    out = ("-o", tmp_path / "x.glb")
    line = assert_fails(capsys, tmp_path, clay, "--model", "phong", *out)
    assert line.startswith("no analytic model 'phong'; there are lambert, ggx, ")
    line = assert_fails(capsys, tmp_path, clay, "-o", tmp_path / "x.usd")
    assert line == (
        f"{tmp_path / 'x.usd'}: no format has the suffix '.usd'; use one of .xml (mitsuba), .json (mitsuba), "
        ".glb (gltf), .gltf (gltf), .mtlx (materialx, or openpbr with --format openpbr), .binary (binary)"
    )
    line = assert_fails(capsys, tmp_path, clay, "--format", "mitsuba", *out)
    assert line == f"{tmp_path / 'x.glb'}: a mitsuba file ends in .xml or .json, not in '.glb'"
    line = assert_fails(capsys, tmp_path, clay, "--format", "gltf")
    assert line == "--format gltf needs a file to write: -o FILE"
    line = assert_fails(capsys, tmp_path, clay, *out, "--preview", tmp_path / "x.gif")
    assert line == f"{tmp_path / 'x.gif'}: image suffix '.gif' is not supported; use .exr, .hdr, .png, .jpg, .jpeg"
    line = assert_fails(capsys, tmp_path, clay, *out, "--preview", tmp_path / "x.png", "--probe", tmp_path / "no.exr")
    assert "no.exr" in line


@pytest.mark.parametrize("option", ["--metric", "--format"])
def test_choices_on_the_command_line(capsys, clay, option):
    with pytest.raises(SystemExit, match="2"):
        main(["analytic", str(clay), option, "ply"])
    assert capsys.readouterr().err.startswith(f"torchbrdf: error: argument {option}: invalid choice: 'ply'")


def test_folders_that_cannot_be_written(capsys, tmp_path, clay):
    for path in (tmp_path / "no" / "x.glb", clay / "x.glb"):
        line = assert_fails(capsys, tmp_path, clay, "--model", "lambert", "-o", path)
        assert line.startswith(f"{path}: cannot write here")


@pytest.fixture(scope="module")
def photo(folder: Path, light: Path, tiny_tables) -> Path:
    image = tb.render(tiny_tables["plastic-0.2"], tb.LightProbe.open(light), tb.SphereView(12))
    tb.write_image(folder / "photo.exr", image)
    return folder / "photo.exr"


@pytest.fixture(scope="module")
def table(folder: Path, tiny_tables) -> Path:
    tiny_tables["gold-0.3"].save(folder / "gold.binary")
    return folder / "gold.binary"


class TestPhotograph:
    """`photo` shows plastic of roughness 0.2; the table is gold."""

    def test_parameters_go_on_from_the_table_on_it(self, capsys, tmp_path, photo, light, table):
        out = tmp_path / "x.glb"
        given = ("--photograph", photo, "--probe", light, "--preview", tmp_path / "x.png", "--most-evaluations", 20)
        words = "analytic", table, "--model", "ggx", *given, "--size", 8, "-o", out, "--json"
        assert main([*map(str, words)]) == 0
        told = json.loads(capsys.readouterr().out)
        at_table, refined, held_at_table, held = told["fits"]
        assert [one["model"] for one in told["fits"]] == ["ggx", "ggx", "metallic-roughness", "metallic-roughness"]
        assert [one["photograph"] for one in told["fits"]] == [None, str(photo), None, str(photo)]
        assert [one["metric"] for one in (at_table, refined)] == ["cube-root", "pixels"]
        assert max(at_table["parameters"]["diffuse"]) < 0.05
        red, green, blue = refined["parameters"]["diffuse"]
        assert red > 0.3 > 0.1 > green > blue
        assert refined["relative_error"] < 0.1
        assert at_table["relative_error_before"] is None
        assert refined["relative_error_before"] > 0.3
        (material,) = json.loads(glb_text(out))["materials"]
        written = material["pbrMetallicRoughness"]["baseColorFactor"][:3]
        assert written == pytest.approx(held["parameters"]["base_color"], rel=1e-5)
        assert written != pytest.approx(held_at_table["parameters"]["base_color"], rel=0.1)
        assert (tmp_path / "x.png").read_bytes()[16:24] == struct.pack(">II", 5 * 8, 8)

    def test_says_which_is_which(self, capsys, tmp_path, photo, light, table):
        preview = tmp_path / "x.png"
        given = ("--photograph", photo, "--probe", light, "--preview", preview, "--size", 8)
        lines, warned = run(capsys, table, "--model", "lambert", *given)
        assert lines[0].startswith(f"photograph {photo}: circle at ")
        first, notice, second = (i for i, line in enumerate(lines) if line.startswith(("lambert", "refined")))
        assert lines[first].endswith("% (cube-root)")
        before, after = (float(re.search(r"([\d.]+)% \(pixels\)", lines[i])[1]) for i in (notice, second))
        assert lines[notice] == f"refined from there on {photo}, where its relative error is {before:.2f}% (pixels):"
        assert after < 5 < 20 < before
        assert not any("of the pixels" in line for line in warned)
        assert lines[-1] == f"wrote {preview}: from left to right gold, lambert, lambert refined"

    def test_what_takes_long_is_said(self, capsys, photo, light, table, monkeypatch):
        monkeypatch.setattr("torchbrdf.progress._PATIENCE", 0.0)
        monkeypatch.setattr("torchbrdf.progress.print", lambda text, **_: said.append(text), raising=False)
        said: list[str] = []
        run(capsys, table, "--model", "lambert", "--photograph", photo, "--probe", light)
        sampling = f"sampling the light that every pixel of {photo} shows, once for all fits"
        assert said == [sampling, f"fitting lambert to {table}"]

    @pytest.mark.parametrize(
        ("more", "said"),
        [
            (("--photograph", "ball.exr"), "--photograph needs the light that it was taken under: give --probe, too"),
            (("--probe", "default"), "--probe is the light of --photograph or of --preview: give one of them, too, or"),
            (("--invert-mask",), "--invert-mask is of a photograph: give --photograph, too"),
            (("--view", "bunny.ply"), "--view is of a photograph: give --photograph, too"),
        ],
    )
    def test_half_of_the_pair_is_refused(self, capsys, tmp_path, table, more, said):
        assert assert_fails(capsys, tmp_path, table, *more, "-o", tmp_path / "x.glb").startswith(said)

    def test_a_photograph_that_is_black_is_named(self, capsys, tmp_path, table):
        tb.write_image(tmp_path / "black.exr", torch.zeros(3, 12, 12))
        given = ("--photograph", tmp_path / "black.exr", "--circle", 6, 6, 6, "--probe", "default")
        line = assert_fails(capsys, tmp_path, table, "--model", "lambert", *given)
        assert line.startswith(f"{tmp_path / 'black.exr'}: ")


def glb_text(path: Path) -> bytes:
    """The JSON in a binary glTF."""
    content = path.read_bytes()
    return content[20 : 20 + struct.unpack("<I", content[12:16])[0]]


@pytest.mark.filterwarnings("ignore:.*material class:UserWarning")
def test_uncertainty_of_a_photograph_weighs_the_cells(capsys, tmp_path, photo, light, tiny_library, monkeypatch):
    verdict = Verdict(GRADES["Good"], [])
    monkeypatch.setattr("torchbrdf.commands._results.write_report", lambda *_, **__: verdict)  # which takes longest
    out = tmp_path / "result"
    monkeypatch.setattr("torchbrdf.commands._lit_sight.open_library", lambda _: tiny_library)
    fit = ["fit", str(photo), "--probe", str(light), "-o", str(out)]
    assert main([*fit, "--uncertainty"]) == 0
    assert f"wrote {out}/brdf_std.binary, brdf.binary, weights.json" in capsys.readouterr().out
    deviation = tb.MerlTable.open(out / "brdf_std.binary")
    assert bool((deviation.valid == above_horizon()).all())
    measured = deviation.values[deviation.valid]
    assert float(measured.min()) >= 0
    assert float(measured.median()) > 0

    given = {}

    def seen(*arguments, **settings):
        given.update(settings)
        return fit_analytic(*arguments, **settings)

    monkeypatch.setattr("torchbrdf.analytic.fit_analytic", seen)
    lines, _ = run(capsys, out, "--model", "lambert", "-o", tmp_path / "x.binary")
    assert lines[0] == f"cells weigh by their standard deviation in {out / 'brdf_std.binary'}"
    torch.testing.assert_close(given["uncertainty"][deviation.valid], measured)
    assert tb.MerlTable.open(tmp_path / "x.binary").name == "x"

    assert main([*fit, "--penalty", "paper"]) == 0
    assert not (out / "brdf_std.binary").exists(), "the deviation of another fit"
    run(capsys, out, "--model", "lambert")
    assert given["uncertainty"] is None


def test_uncertainty_needs_a_posterior(capsys, tmp_path, photo):
    line = fails(
        capsys, "fit", photo, "--probe", "default", "--penalty", "0.5", "--uncertainty", "-o", tmp_path / "out"
    )
    assert line == "torchbrdf: error: --uncertainty needs --penalty auto, a fixed one has no posterior; got 0.5"
    assert not (tmp_path / "out").exists()
