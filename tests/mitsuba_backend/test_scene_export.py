"""An exported folder, loaded by Mitsuba as a user would, renders what `MitsubaScene` renders."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from math import cos, pi, sin
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

import torchbrdf as tb
from materials import TINY_MATERIALS
from paths import ROOT
from torchbrdf import Camera, MeshView
from torchbrdf.cli import main
from torchbrdf.images import exposure_for, read_picture
from torchbrdf.images.difference import relative_rms
from torchbrdf.mitsuba_backend.merl_plugin import register_merl
from torchbrdf.mitsuba_backend.scene_export import export_scene, scene_xml
from torchbrdf.mitsuba_backend.scenes import MitsubaScene

SAMPLES = 64
SPHERE_FILES = ["README.txt", "brdf.binary", "probe.exr", "render.py", "scene.xml"]


@pytest.fixture
def mi(mitsuba: ModuleType) -> ModuleType:
    register_merl()
    return mitsuba


@pytest.fixture(scope="module")
def table() -> tb.MerlTable:
    return tb.MerlTable.from_function(TINY_MATERIALS["plastic-0.1"], "plastic & <rough>")


@pytest.fixture(scope="module")
def probe() -> tb.LightProbe:
    """Every texel its own: a turned, flipped or wrongly decoded map renders another image. Some are very bright."""
    noise = torch.rand(3, 16, 32, generator=torch.Generator().manual_seed(0))
    return tb.LightProbe(10 ** (4 * noise - 2))


@pytest.fixture(scope="module")
def egg(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An ellipsoid, turned and away from the origin."""
    trimesh = pytest.importorskip("trimesh")
    shape = trimesh.creation.icosphere(2)
    shape.apply_scale([1.0, 0.7, 0.5])
    shape.apply_transform(trimesh.transformations.rotation_matrix(0.8, [0.3, 1.0, -0.5], point=[0.5, 0.2, -0.1]))
    path = tmp_path_factory.mktemp("shape") / "egg.ply"
    shape.export(path, vertex_normal=True)
    return path


def views(egg: Path) -> dict[str, tb.View]:
    tilted = {"toward": (0.9, 0.5, 0.6), "up": (0.2, 1.0, -0.3)}
    return {
        "sphere": tb.SphereView(24),
        "sphere in perspective": tb.SphereView(24, fov_deg=50.0),
        "mesh": MeshView(egg, 24, Camera(**tilted)),
        "mesh in perspective": MeshView(egg, 24, Camera(**tilted, fov_deg=35.0)),
    }


@pytest.mark.parametrize("name", ["sphere", "sphere in perspective", "mesh", "mesh in perspective"])
def test_exported_scene_is_the_scene(mi, table, probe, egg, tmp_path, name):
    """With equal seeds, to the rounding of the files: a mesh's rays may round into another cell now and then."""
    view = views(egg)[name]
    folder = tmp_path / "a folder with spaces & é"
    export_scene(table, probe, view, folder)
    assert sorted(path.name for path in folder.iterdir()) == sorted([*SPHERE_FILES, *["mesh.ply"] * ("mesh" in name)])

    def picture(scene) -> torch.Tensor:
        return torch.from_numpy(np.array(mi.render(scene, spp=SAMPLES, seed=5))).permute(2, 0, 1)

    got = picture(mi.load_file(str(folder / "scene.xml")))
    expected = picture(MitsubaScene(view, probe, table).scene)
    assert relative_rms(got, expected, view.mask) < (1e-6 if "sphere" in name else 0.01)
    assert float(got[:, 0, 0].abs().max()) == 0, "the light is not seen beside the shape"
    assert relative_rms(got.flip(-1), expected, view.mask) > 0.1, "the check sees another image"


def test_probe_is_read_with_its_values_in_its_places(mi, table, probe, tmp_path):
    import drjit as dr

    export_scene(table, probe, tb.SphereView(8), tmp_path / "out")
    (light,) = mi.load_file(str(tmp_path / "out" / "scene.xml")).emitters()
    for row, column in ((1, 0), (5, 31), (7, 12), (14, 20)):
        phi, theta = 2 * pi * (column + 0.5) / 32, pi * row / 15
        hit = dr.zeros(mi.SurfaceInteraction3f)
        hit.wi = mi.Vector3f(-sin(phi) * sin(theta), -cos(theta), cos(phi) * sin(theta))
        seen = np.array(light.eval(hit)).ravel()
        np.testing.assert_allclose(seen, probe.radiance[:, row, column].numpy(), rtol=1e-3)
    assert torch.equal(tb.read_image(tmp_path / "out" / "probe.exr"), probe.radiance)
    assert torch.equal(tb.LightProbe.open(tmp_path / "out" / "probe.exr").radiance, probe.radiance)


def test_table_is_kept(table, probe, tmp_path):
    export_scene(table, probe, tb.SphereView(8), tmp_path / "out")
    read = tb.MerlTable.open(tmp_path / "out" / "brdf.binary")
    torch.testing.assert_close(read.filled, table.filled, rtol=1e-12, atol=1e-15)


def test_render_script(mi, table, probe, tmp_path):
    """One command from anywhere, as the README says; its picture is the scene's."""
    folder = tmp_path / "out"
    export_scene(table, probe, tb.SphereView(16), folder)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(folder / "render.py"), "--samples", "32", "--seed", "2"]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    image = tb.read_image(folder / "image.exr")
    exposure = exposure_for(image, image.amax(0, keepdim=True) > 0)
    assert done.stdout == f"wrote {folder / 'image.exr'}, and image.png, radiance times {exposure:.3g}\n"
    shown = read_picture(folder / "image.png", True).image.amax(0)
    assert 0.005 < float((shown == 1).sum() / (shown > 0).sum()) < 0.03, "a hundredth is white"
    scene = mi.load_file(str(folder / "scene.xml"))
    expected = torch.from_numpy(np.array(mi.render(scene, spp=32, seed=2))).permute(2, 0, 1)
    torch.testing.assert_close(tb.read_image(folder / "image.exr"), expected, rtol=1e-4, atol=1e-5)
    assert (folder / "image.png").stat().st_size > 0


def test_files_name_no_other_place(table, probe, tmp_path):
    """The folder may be moved: the scene's file names are relative and there."""
    export_scene(table, probe, tb.SphereView(8, fov_deg=30.0), tmp_path / "out")
    nodes = ET.parse(tmp_path / "out" / "scene.xml").iter()
    names = [node.get("value") for node in nodes if node.get("name") == "filename"]
    assert sorted(map(str, names)) == ["brdf.binary", "probe.exr"]
    for file in ("scene.xml", "render.py", "README.txt"):
        assert str(tmp_path) not in (tmp_path / "out" / file).read_text()
    assert "plastic & <rough>" in (tmp_path / "out" / "README.txt").read_text()


def test_view_without_a_shape(table, probe, tmp_path):
    normals = torch.zeros(3, 8, 8)
    normals[2] = 1
    with pytest.raises(ValueError, match=r"^Mitsuba needs a shape to trace, got NormalMapView.*; give a SphereView"):
        export_scene(table, probe, tb.NormalMapView(normals), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_whole_or_absent(table, probe, tmp_path, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("torchbrdf.light.probe.write_image", fail)
    with pytest.raises(OSError, match="disk full"):
        export_scene(table, probe, tb.SphereView(8), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_camera_of_a_sphere():
    """Written out by hand: the camera is on +Z, 4 away, and shows from -1 to 1."""
    root = ET.fromstring(scene_xml(tb.SphereView(40)).encode())
    sensor = root.find("sensor")
    assert sensor is not None
    assert sensor.get("type") == "orthographic"
    lookat, scale = sensor.find("transform/lookat"), sensor.find("transform/scale")
    assert lookat is not None
    assert scale is not None
    assert lookat.attrib == {"origin": "0.0, 0.0, 4.0", "target": "0.0, 0.0, 0.0", "up": "0.0, 1.0, 0.0"}
    assert scale.attrib == {"x": "1.0", "y": "1.0", "z": "1"}
    assert [node.get("value") for node in sensor.iter("integer")] == ["40", "40"]


def test_command(mi, table, probe, egg, tmp_path, capsys):
    table.save(tmp_path / "plastic.binary")
    probe.save(tmp_path / "light.exr")
    inputs = [str(tmp_path / "plastic.binary"), "--probe", str(tmp_path / "light.exr"), "--size", "16"]
    assert main(["export", *inputs, "-o", str(tmp_path / "ball")]) == 0
    assert sorted(path.name for path in (tmp_path / "ball").iterdir()) == SPHERE_FILES
    assert "render.py" in capsys.readouterr().out
    assert main(["export", *inputs, "--view", str(egg), "--fov", "30", "-o", str(tmp_path / "egg")]) == 0
    assert (tmp_path / "egg" / "mesh.ply").is_file()
    image = np.array(mi.render(mi.load_file(str(tmp_path / "egg" / "scene.xml")), spp=4))
    assert image.shape == (16, 16, 3)
    assert np.isfinite(image).all()
    assert image.max() > 0


def test_command_says_what_is_wrong(probe, tmp_path, capsys):
    missing = tmp_path / "nowhere.binary"
    assert main(["export", str(missing), "--probe", "default", "-o", str(tmp_path / "out")]) == 2
    assert f"{missing}: no such file" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
