"""`torchbrdf bake`, and `torchbrdf fit` of other shapes than a ball with what it wrote."""

import json
from functools import partial
from pathlib import Path

import pytest
import torch

import torchbrdf as tb
from torchbrdf.cli import main
from torchbrdf.mitsuba_backend import baking
from torchbrdf.photograph.observation import observe_view
from torchbrdf.report import write_report

SIZE = 24
pytestmark = pytest.mark.usefixtures("mitsuba")


@pytest.fixture(scope="module")
def ellipsoid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A smooth mesh with normals."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.icosphere(subdivisions=4)
    mesh.vertices *= [1.0, 0.7, 0.8]
    path = tmp_path_factory.mktemp("mesh") / "ellipsoid.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=True))
    return path


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def bake(library: Path, mesh: Path, output: Path, *more: object) -> int:
    settings = ("--probe", "default", "--library", library, "--view", mesh, "--size", SIZE, "--samples", 48)
    return run("bake", *settings, *more, "-o", output)


def test_baked_images_serve_a_fit_of_the_same_shape(
    merl_directory, tiny_tables, ellipsoid, tmp_path, capsys, monkeypatch
):
    """Its report has small pictures."""
    monkeypatch.setattr("torchbrdf.commands._results.write_report", partial(write_report, size=16, samples=16))
    basis_file, photo = tmp_path / "basis.safetensors", tmp_path / "photo.exr"
    assert bake(merl_directory, ellipsoid, basis_file) == 0
    assert "estimated error of the 24 images" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["basis.safetensors"]

    view = tb.MeshView(ellipsoid, SIZE)
    tb.write_image(photo, tb.render(tiny_tables["satin-0.5"], tb.LightProbe.default(), view))
    settings = ("--probe", "default", "--library", merl_directory, "--view", ellipsoid)
    assert run("fit", photo, *settings, "--basis", basis_file, "-o", tmp_path / "out") == 0
    record = json.loads((tmp_path / "out" / "weights.json").read_text())
    classes = tb.MaterialClasses.fit(tb.MaterialLibrary.from_merl(merl_directory))
    result = tb.BRDFEstimator(tb.BasisImages.load(basis_file), classes)(tb.read_image(photo))
    assert record["relative_error"] == pytest.approx(float(result.relative_error), rel=1e-3)
    assert record["normal_coverage"] > 0.9
    assert tb.MerlTable.open(tmp_path / "out" / "brdf.binary").valid.any()

    capsys.readouterr()
    other = ("--probe", "default", "--library", merl_directory, "--view", ellipsoid, "--toward", 1, 0, 0)
    assert run("fit", photo, *other, "--basis", basis_file, "-o", tmp_path / "no") == 2
    assert "basis.safetensors: rendered with another view" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_interrupted_bake_goes_on_to_the_same_images(merl_directory, ellipsoid, tmp_path, capsys, monkeypatch):
    undisturbed, output = tmp_path / "undisturbed.safetensors", tmp_path / "basis.safetensors"
    assert bake(merl_directory, ellipsoid, undisturbed) == 0
    whole = baking._render_pass
    passes = []

    def interrupted(*arguments):
        if len(passes) == 3:
            raise KeyboardInterrupt
        passes.append(1)
        return whole(*arguments)

    monkeypatch.setattr(baking, "_render_pass", interrupted)
    assert bake(merl_directory, ellipsoid, output) == 130
    assert "the same command goes on" in capsys.readouterr().err
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["basis.safetensors.unfinished", "undisturbed.safetensors"]

    assert bake(merl_directory, ellipsoid, output, "--seed", 1) == 2
    assert "the state of another bake" in capsys.readouterr().err

    monkeypatch.setattr(baking, "_render_pass", whole)
    assert bake(merl_directory, ellipsoid, output) == 0
    assert not Path(f"{output}.unfinished").exists()
    expected, found = tb.BasisImages.load(undisturbed), tb.BasisImages.load(output)
    assert torch.equal(found.packed, expected.packed)
    assert torch.equal(found.relative_errors, expected.relative_errors)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--view", "sphere", "--toward", 1, 0, 0), "--toward is for a mesh, and --view is sphere"),
        (("--view", "nowhere.ply"), "nowhere.ply: no such file"),
        (("--view", "normals.exr", "--fov", 30), "--fov is for a sphere or a mesh"),
        (("--view", "cone"), "cone"),
    ],
)
def test_bad_input_is_one_line(merl_directory, tmp_path, capsys, arguments, message):
    settings = ("--probe", "default", "--library", merl_directory)
    assert run("bake", *settings, *arguments, "-o", tmp_path / "b.safetensors") == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert message in lines[0]
    assert not list(tmp_path.iterdir())


def test_normal_map(merl_directory, tmp_path, capsys):
    path = tmp_path / "normals.exr"
    tb.write_image(path, tb.SphereView(16).normals)
    output = tmp_path / "b.safetensors"
    settings = ("--probe", "default", "--library", merl_directory)
    assert run("bake", *settings, "--view", path, "--samples", 8, "-o", output) == 0
    assert tb.BasisImages.load(output).size == (16, 16)


def test_photograph_of_other_proportions(merl_directory, ellipsoid, tmp_path, capsys):
    photo = tmp_path / "photo.exr"
    tb.write_image(photo, torch.ones(3, 20, 30))
    settings = ("--probe", "default", "--library", merl_directory, "--view", ellipsoid)
    assert run("fit", photo, *settings, "-o", tmp_path / "out") == 2
    assert "photo.exr: the photograph is 20 x 30 and the view 30 x 30" in capsys.readouterr().err


def test_photograph_is_averaged_onto_the_view(ellipsoid, tmp_path):
    view = tb.MeshView(ellipsoid, SIZE)
    small = torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(1)) + 0.1
    found = observe_view(small.repeat_interleave(3, 1).repeat_interleave(3, 2), view)
    assert torch.equal(found.mask, view.mask)
    assert torch.allclose(found.image, torch.where(view.mask, small, 0), atol=1e-6)
