"""`MeshView` and `Camera`: a fine mesh of a sphere is a sphere, any camera sees it right, shadows fall as they must."""

import dataclasses
import re
import warnings
from math import pi, radians, sin, tan

import numpy as np
import pytest
import torch
from torch.nn.functional import normalize

from materials import lambert

pytest.importorskip("trimesh", reason="trimesh is not installed")

import trimesh

import torchbrdf as tb
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.mitsuba_backend.baking import bake_basis
from torchbrdf.mitsuba_backend.scenes import MitsubaScene
from torchbrdf.rendering.directional import render_directional
from torchbrdf.view.camera import Camera
from torchbrdf.view.mesh_view import MeshView
from torchbrdf.view.sphere import SphereView

pytestmark = pytest.mark.usefixtures("mitsuba")


def save(mesh, path, normals=True):
    path.write_bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=normals))
    return path


@pytest.fixture(scope="module")
def sphere_file(tmp_path_factory):
    """A unit sphere of 20,480 triangles with exact normals."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    points = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    mesh = trimesh.Trimesh(points, mesh.faces, vertex_normals=points, process=False)
    return save(mesh, tmp_path_factory.mktemp("mesh") / "sphere.ply")


@pytest.fixture(scope="module")
def grey():
    return MerlTable.from_function(lambert(0.8, 0.5, 0.2), "grey")


@pytest.fixture(scope="module")
def probe():
    return LightProbe.default(16)


def write_obj(path, corners, faces):
    """Quads or triangles with flat normals, so that nothing warns."""
    lines, normals = [f"v {x} {y} {z}" for x, y, z in corners], []
    for index, face in enumerate(faces):
        a, b, c = (np.array(corners[k], dtype=float) for k in face[:3])
        n = np.cross(b - a, c - a)
        normals.append("vn {} {} {}".format(*(n / np.linalg.norm(n))))
        lines.append("f " + " ".join(f"{k + 1}//{index + 1}" for k in face))
    path.write_text("\n".join(lines[: len(corners)] + normals + lines[len(corners) :]) + "\n")
    return path


# A sphere


@pytest.mark.parametrize("fov_deg", [None, 30.0, 75.0])
def test_a_fine_sphere_is_a_sphere_view(sphere_file, fov_deg):
    n = 16
    sphere, mesh = SphereView(n, fov_deg=fov_deg), MeshView(sphere_file, n, Camera(fov_deg=fov_deg))
    assert torch.equal(mesh.mask, sphere.mask)
    generator = torch.Generator().manual_seed(0)
    u, v = torch.floor(torch.rand(2, len(sphere.pixels), 20, generator=generator) * 16) / 16 + 1 / 32
    expected, found = sphere.surface(sphere.pixels, u, v), mesh.surface(mesh.pixels, u, v)
    torch.testing.assert_close(found.normals, expected.normals, rtol=0, atol=4e-3)
    torch.testing.assert_close(found.view_dirs.expand_as(expected.view_dirs), expected.view_dirs, rtol=0, atol=1e-4)
    torch.testing.assert_close(found.positions, expected.normals, rtol=0, atol=4e-3)
    centre = (slice(None), n // 2, n // 2)
    torch.testing.assert_close(mesh.normals[centre], torch.tensor([1 / 16, -1 / 16, 1.0]), rtol=0, atol=0.03)


@pytest.mark.parametrize("fov_deg", [None, 50.0])
def test_a_fine_sphere_renders_like_a_sphere_view(sphere_file, tiny_tables, probe, fov_deg):
    table = tiny_tables["satin-0.35"]
    sphere, mesh = SphereView(10, fov_deg=fov_deg), MeshView(sphere_file, 10, Camera(fov_deg=fov_deg))
    ours, expected = (tb.render(table, probe, view, samples=4096) for view in (mesh, sphere))
    assert (ours - expected).norm() / expected.norm() < 0.01
    halves = MitsubaScene(mesh, probe, table).render_halves(2048)
    assert halves.noise < 0.05
    assert (halves.image - expected).norm() / expected.norm() < 1.5 * halves.noise + 0.005
    directional = [render_directional(table, view, 60, irradiance=pi) for view in (mesh, sphere)]
    assert (directional[0] - directional[1]).norm() / directional[1].norm() < 0.01


# Cameras

TILTED = {"right": (2, 0, -1), "top": (-2, 5, -4), "back": (1, 2, 2)}
"""For toward (1, 2, 2) and up +Y, by hand: right = up x back, top = back x right; not normalised."""


@pytest.mark.parametrize("fov_deg", [None, 40.0])
def test_a_tilted_camera(sphere_file, grey, probe, fov_deg):
    """In the camera's axes the sphere looks as ever, and light turned with the camera gives the same picture."""
    axes = normalize(torch.tensor([TILTED[key] for key in ("right", "top", "back")], dtype=torch.float64), dim=1)
    view = MeshView(sphere_file, 8, Camera(toward=(1, 2, 2), fov_deg=fov_deg))
    sphere = SphereView(8, fov_deg=fov_deg)
    assert torch.equal(view.mask, sphere.mask)
    for found, expected in ((view.normals, sphere.normals), (view.view_dirs, sphere.view_dirs)):
        turned = torch.einsum("ij,jhw->ihw", axes.float(), found)
        torch.testing.assert_close(turned, expected, rtol=0, atol=0.04)
    expected = tb.render(grey, probe.rotated(axes), sphere, samples=2048)
    for picture in (tb.render(grey, probe, view, samples=2048), MitsubaScene(view, probe, grey).render(2048)):
        assert (picture - expected).norm() / expected.norm() < 0.03
    wrong = tb.render(grey, probe, sphere, samples=2048)
    assert (wrong - expected).norm() / expected.norm() > 0.1


def test_up_turns_the_image(sphere_file):
    upright, turned = (MeshView(sphere_file, 9, Camera(up=up)) for up in ((0, 1, 0), (1, 0, 0)))
    torch.testing.assert_close(turned.normals, upright.normals.rot90(1, (1, 2)), rtol=0, atol=0.05)
    assert turned.normals[0, 1, 4] > 0.5


def test_a_camera_at_a_position(sphere_file):
    """The default camera of a field of view stands where its cone touches the sphere."""
    distance = 1 / sin(radians(20))
    placed = MeshView(sphere_file, 15, Camera.at((0, 0, distance), (0, 0, 0), 40))
    default = MeshView(sphere_file, 15, Camera(fov_deg=40))
    assert torch.equal(placed.mask, default.mask)
    torch.testing.assert_close(placed.normals, default.normals, rtol=0, atol=2e-3)
    assert placed.framing.half_width == pytest.approx(distance * tan(radians(20)))

    farther = MeshView(sphere_file, 31, Camera.at((0, 0, 10), (0, 0, 0), 40))
    radius = 15.5 / (99**0.5 * tan(radians(20)))  # in pixels: the cone that touches has tan = 1 / sqrt(99)
    assert len(farther.pixels) == pytest.approx(pi * (radius - 0.6) ** 2, rel=0.12)

    aside = MeshView(sphere_file, 31, Camera.at((1, 0, 10), (1, 0, 0), 40))
    columns = aside.mask[0].any(0).nonzero().ravel().float()
    assert columns.mean() == pytest.approx(15 - 15.5 / (10 * tan(radians(20))), abs=0.6)
    x, y, z = (axis[aside.mask[0]] for axis in aside.view_dirs)
    assert (x > 0).all()
    assert z.min() > 0.9
    assert y.abs().max() < 0.12


def test_target_and_width(sphere_file):
    """Half of the sphere's width, shifted to the right and up."""
    view = MeshView(sphere_file, 16, Camera(target=(0.1, 0.1, 0), width=1.0))
    assert bool(view.mask.all())
    step = (torch.arange(16) + 0.5) / 16 - 0.5
    expected = torch.stack([(0.1 + step).expand(16, 16), (0.1 - step)[:, None].expand(16, 16)])
    torch.testing.assert_close(view.normals[:2], expected, rtol=0, atol=5e-3)


@pytest.mark.parametrize(
    "arguments",
    [
        {"toward": (0, 0, 0)},
        {"toward": (0, -1, 0)},
        {"toward": (float("nan"), 0, 1)},
        {"toward": (0, 1)},
        {"up": (0, 0, 0)},
        {"up": (0, 0, -3)},
        {"up": (float("inf"), 0, 0)},
        {"fov_deg": 0},
        {"fov_deg": 180},
        {"fov_deg": -10},
        {"fov_deg": float("nan")},
        {"width": 0},
        {"width": -1},
        {"width": float("inf")},
        {"width": float("nan")},
        {"target": (0, float("nan"), 0)},
        {"target": (0, 0)},
    ],
)
def test_silly_cameras(arguments):
    (name,) = arguments
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=rf"^[^\n]*({name}|direction)[^\n]*$"):
            Camera(**arguments)


def test_a_camera_at_its_own_target():
    with pytest.raises(ValueError, match=r"^[^\n]*(position|target|direction)[^\n]*$"):
        Camera.at((1, 2, 3), (1, 2, 3), 40)


@pytest.mark.parametrize("size", [-4, 0, 1, 2])
def test_silly_sizes(sphere_file, size):
    with pytest.raises(ValueError, match=rf"^[^\n]*3 x 3[^\n]*got size={size}$"):
        MeshView(sphere_file, size)


@pytest.mark.parametrize(
    "camera",
    [
        Camera(target=(10, 0, 0)),
        Camera.at((0, 0, 5), (0, 0, 9), 40),
        Camera(width=1e6),
        Camera.at((0, 0, 0), (0, 0, -1), 40),
    ],
    ids=["aside", "behind", "too small", "inside"],
)
def test_a_mesh_outside_the_camera(sphere_file, camera):
    with pytest.raises(ValueError, match=rf"^{re.escape(str(sphere_file))}: no pixel[^\n]*camera[^\n]*$"):
        MeshView(sphere_file, 16, camera)


def test_a_bad_mesh_is_refused_by_the_view(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"absent\.ply: no such file"):
        MeshView(tmp_path / "absent.ply", 8)
    (tmp_path / "text.ply").write_text("hello")
    with pytest.raises(ValueError, match=r"text\.ply: not a sound .ply mesh"):
        MeshView(tmp_path / "text.ply", 8)


# Shadows

HEIGHT, LENGTH = 1.0, 4.0
"""Of the wall, which stands on the floor in the plane x = 0."""


@pytest.fixture(scope="module")
def yard_file(tmp_path_factory):
    """A floor 4 x 4 in y = 0 with a wall across it; both face up and +X."""
    corners = [(-2, 0, -2), (-2, 0, 2), (2, 0, 2), (2, 0, -2)]
    corners += [(0, 0, -LENGTH), (0, HEIGHT, -LENGTH), (0, HEIGHT, LENGTH), (0, 0, LENGTH)]
    return write_obj(tmp_path_factory.mktemp("yard") / "yard.obj", corners, [(0, 1, 2, 3), (4, 5, 6, 7)])


def from_above(path, shadows=True):
    """16 x 16 pixels on the floor, columns from x = -2 to 2, rows from z = -2 to 2."""
    return MeshView(path, 16, Camera(toward=(0, 1, 0), up=(0, 0, -1), target=(0, 0, 0), width=4.0), shadows)


def open_sky():
    """(16,) share of the irradiance from white light that reaches floor points, per column, z = 0 to 2 averaged."""
    x, z = (torch.arange(64, dtype=torch.float64) + 0.5) / 16 - 2, (torch.arange(8, dtype=torch.float64) + 0.5) / 4
    y = (torch.arange(200, dtype=torch.float64) + 0.5) / 200 * HEIGHT
    s = ((torch.arange(800, dtype=torch.float64) + 0.5) / 400 - 1) * LENGTH
    x, z, y, s = x[:, None, None, None], z[:, None, None], y[:, None], s
    square = x * x + y * y + (z - s) ** 2
    blocked = (y * x.abs() / square**2).sum((-1, -2)) * (HEIGHT / 200) * (LENGTH / 400) / pi
    return (1 - blocked.mean(1)).view(16, 4).mean(1)


def test_hand_calculated_visibility(yard_file):
    view = from_above(yard_file)
    assert bool(view.mask.all())
    points = view.surface(view.pixels, torch.full((256, 1), 0.53), torch.full((256, 1), 0.53))
    x = points.positions[0, :, 0]
    column = (view.pixels % 16).float()
    torch.testing.assert_close(x, -2 + 0.25 * (column + 0.53), rtol=0, atol=0.01)
    torch.testing.assert_close(points.positions[2, :, 0], -2 + 0.25 * ((view.pixels // 16) + 0.53), rtol=0, atol=0.01)
    torch.testing.assert_close(points.normals[:, :, 0], torch.tensor([[0.0], [1], [0]]).expand(3, 256))
    for slope in (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0):
        w_i = normalize(torch.tensor([slope, 1.0, 0.0]), dim=0)[:, None, None].expand(3, 256, 1)
        end = -slope * HEIGHT
        shaded = (x > min(0, end)) & (x < max(0, end))
        assert torch.equal(view.visibility(points, w_i)[:, 0], ~shaded)
    below = torch.tensor([0.3, -1.0, 0.0])[:, None, None].expand(3, 256, 1)
    assert not view.visibility(points, below).any()
    assert from_above(yard_file, shadows=False).visibility(points, below) is None


def test_hand_calculated_directional_light(yard_file, grey):
    direction = torch.tensor([-1.0, 1.0, 0.0])
    expected = torch.full((16,), 0.5 / pi * 0.5**0.5)
    for shadows in (True, False):
        picture = render_directional(grey, from_above(yard_file, shadows), direction=direction)
        if shadows:
            expected[8:12] = 0  # the wall shades x = 0 to 1, whole pixels
        else:
            expected[8:12] = expected[0]
        torch.testing.assert_close(picture[1], expected.expand(16, 16), rtol=1e-3, atol=1e-5)


def test_hand_calculated_shadows_of_white_light(yard_file, grey):
    """Ours, Mitsuba's and the baked images against the form factor of the wall; without shadows the floor is white."""
    white, view = LightProbe(torch.ones(3, 16, 32)), from_above(yard_file)
    expected = 0.5 * open_sky()
    assert expected.min() < 0.32
    library = MaterialLibrary.from_tables([grey])
    pictures = {
        "transport": tb.render(grey, white, view, samples=2048),
        "mitsuba": MitsubaScene(view, white, grey).render(16384),
        "basis": tb.render_basis(library, white, view, samples=2048).image("grey"),
        "baked": bake_basis(library, white, view, 2048).image("grey"),
    }
    for name, picture in pictures.items():
        found = picture[1].double()
        columns = torch.cat([found[8:], found[:8].flip(0)]).mean(0)
        torch.testing.assert_close(columns, expected, rtol=0.006, atol=0, msg=lambda text, name=name: f"{name}: {text}")
    flat = tb.render(grey, white, from_above(yard_file, shadows=False), samples=512)
    torch.testing.assert_close(flat[1], torch.full((16, 16), 0.5), rtol=0.03, atol=0)
    assert flat[1].mean() == pytest.approx(0.5, rel=2e-3)


def test_interreflection_is_for_the_path_integrator_only(yard_file, grey):
    white, view = LightProbe(torch.ones(3, 8, 16)), from_above(yard_file)
    direct, path = (MitsubaScene(view, white, grey, {"type": kind}).render(512) for kind in ("direct", "path"))
    assert path[0].mean() > 1.01 * direct[0].mean()


def test_light_from_behind_a_plane_is_no_light(tmp_path, grey):
    """No point faces the light, so that no ray is traced at all."""
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    view = MeshView(write_obj(tmp_path / "plane.obj", corners, [(0, 1, 2, 3)]), 8)
    assert not render_directional(grey, view, 136).any()
    behind = torch.zeros(3, 8, 16)
    behind[:, 4, 0] = 1  # -Z
    assert tb.render(grey, LightProbe(behind), view, samples=64).max() < 1e-3


def test_shadows_false_differs(yard_file, grey, probe):
    with_shadows, without = (tb.render(grey, probe, from_above(yard_file, s), samples=512) for s in (True, False))
    assert (without >= with_shadows * 0.9).all()
    assert without.mean() > 1.03 * with_shadows.mean()


@pytest.mark.parametrize("material", ["white", "gold-0.3"])
def test_a_bunny_renders_the_same_in_both(shared_data, tiny_tables, probe, material):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        view = MeshView(shared_data / "shapes" / "bunny.ply", 24)
    ours = tb.render(tiny_tables[material], probe, view, samples=4096)
    halves = MitsubaScene(view, probe, tiny_tables[material]).render_halves(8192)
    allowed = 0.005 + 2 * halves.noise / len(view.pixels) ** 0.5
    assert allowed < 0.01
    assert float(ours.mean() / halves.image.mean()) == pytest.approx(1, abs=allowed)
    assert (ours - halves.image).norm() / ours.norm() < 1.5 * halves.noise + 0.02
    assert float(ours.mean()) > 0


# Identity and coverage


def test_fingerprints(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=3)
    places, faces, normals = ball.vertices, ball.faces, ball.vertices
    mesh = trimesh.Trimesh(places, faces, vertex_normals=normals, process=False)
    original, copy = (save(mesh, tmp_path / f"{name}.ply") for name in ("original", "copy"))

    def prints(path=original, size=8, camera=None, **options):
        return MeshView(path, size, camera, **options).fingerprint

    bent = normalize(torch.tensor(normals + np.array([0.01, 0, 0])), dim=1).numpy()
    moved = trimesh.Trimesh(places * [1, 1, 0.999], faces, vertex_normals=normals, process=False)
    turned = trimesh.Trimesh(places, faces, vertex_normals=bent, process=False)
    cut = trimesh.Trimesh(places, faces[:-1], vertex_normals=normals, process=False)
    cameras = [
        Camera(toward=(0, 0.1, 1)), Camera(up=(0.1, 1, 0)), Camera(fov_deg=30), Camera(fov_deg=31),
        Camera(target=(0.1, 0, 0)), Camera(width=1.9), Camera(fov_deg=30, width=1.9),
    ]  # fmt: skip
    different = [prints(), prints(size=9), prints(shadows=False), *(prints(camera=camera) for camera in cameras)]
    different += [prints(save(mesh, tmp_path / f"{k}.ply")) for k, mesh in enumerate((moved, turned, cut))]
    assert len(set(different)) == len(different)
    assert prints(copy) == prints() == prints(camera=Camera())
    assert prints() != SphereView(8).fingerprint
    fields = {field.name for field in dataclasses.fields(Camera)}
    assert fields == {"toward", "up", "fov_deg", "target", "width"}, "a new field needs a line above"


def test_a_camera_in_whole_numbers_is_the_same_camera(sphere_file):
    assert MeshView(sphere_file, 8, Camera((0, 0, 1))).fingerprint == MeshView(sphere_file, 8).fingerprint


def test_normal_coverage_and_the_estimators_warning(sphere_file, tmp_path, tiny_library, probe):
    classes = tb.MaterialClasses.fit(tiny_library, n_classes=1, n_dims=2)
    oblique = Camera(toward=(1, 0.7, 1.3))
    plane = write_obj(tmp_path / "plane.obj", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)])
    cube = save(trimesh.creation.box(), tmp_path / "cube.ply", normals=False)
    cylinder = save(trimesh.creation.cylinder(0.5, 2, sections=96), tmp_path / "cylinder.ply", normals=False)
    shares = {}
    for name, path, camera in (
        ("plane", plane, Camera()),
        ("cube", cube, oblique),
        ("cylinder", cylinder, Camera(toward=(1, 0, 0))),
        ("sphere", sphere_file, oblique),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            view = MeshView(path, 24, camera)
        shares[name] = view.normal_coverage
        basis = tb.render_basis(tiny_library, probe, view, samples=64)
        assert basis.normal_coverage == view.normal_coverage
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            tb.BRDFEstimator(basis, classes)
        messages = [str(warning.message) for warning in caught]
        if name == "sphere":
            assert not messages
        else:
            assert len(messages) == 1
            assert re.search(r"normals", messages[0]), messages
            assert "\n" not in messages[0]
    assert 0 < shares["plane"] < 0.02
    assert shares["plane"] < shares["cube"] < 0.05
    assert shares["cube"] < shares["cylinder"] < 0.15
    assert shares["sphere"] > 0.95
