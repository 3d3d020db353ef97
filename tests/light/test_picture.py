"""Files with pictures of light: where rows lie, discs in photographs, cubes, and what is refused."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from torch import Tensor

from probes import texel_directions
from torchbrdf import LightProbe, read_image, write_image

SPHERE = 4 * math.pi


def scene(d: Tensor) -> Tensor:
    """A smooth asymmetric radiance (3, ...) of directions (..., 3)."""
    x, y, z = d.unbind(-1)
    return torch.stack([1.5 + x + 0.3 * y * z, 1.5 + y + 0.3 * x * z, 1.5 + z + 0.3 * x * y])


def towards(theta: float, phi: float) -> Tensor:
    return torch.tensor(
        [math.sin(phi) * math.sin(theta), math.cos(theta), -math.cos(phi) * math.sin(theta)], dtype=torch.float64
    )


def noise(height: int, width: int, seed: int = 0) -> Tensor:
    return 10 ** (3 * torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed)) - 1)


def mean_direction(probe: LightProbe) -> Tensor:
    weighted = probe.radiance[0].double() * probe.solid_angles
    mean = (weighted[..., None] * texel_directions(probe.height).double()).sum((0, 1))
    return mean / mean.norm()


@pytest.fixture
def file(tmp_path: Path) -> Callable[[Tensor], Path]:
    def write(picture: Tensor) -> Path:
        write_image(tmp_path / "probe.exr", picture)
        return tmp_path / "probe.exr"

    return write


def write_envmap(path: Path, picture: Tensor, kind: object) -> None:
    """An .exr file that says in OpenEXR's way that it is an environment map."""
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, "envmap": kind}
    channels = {name: np.ascontiguousarray(plane) for name, plane in zip("RGB", picture.numpy(), strict=True)}
    with OpenEXR.File(header, channels) as out:
        out.write(str(path))


@pytest.mark.parametrize("key", ["envmap", "probeRows"])
@pytest.mark.parametrize("value", ["latlong", 3, (1.0, 2.0), np.array([1, 2], "i4")])
def test_attributes_of_another_type_say_nothing(tmp_path, key, value):
    planes = {name: np.ones((4, 8), "f4") for name in "RGB"}
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, key: value}
    with OpenEXR.File(header, planes) as out:
        out.write(str(tmp_path / "a.exr"))
    assert LightProbe.open(tmp_path / "a.exr").reading == "rows at pixel centres"


# --- Rows ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("height", [2, 5, 64, 100])
@pytest.mark.parametrize("rows", [None, 7, 64, 130])
def test_bands_keep_the_energy(file, height, rows):
    """Exactly: what a texel gives is its radiance times the area of its cell."""
    picture = noise(height, 2 * height)
    theta = torch.arange(height + 1, dtype=torch.float64) * (math.pi / height)
    areas = (theta.cos()[:-1] - theta.cos()[1:]) * (2 * math.pi / (2 * height))
    power = (picture.double() * areas[:, None]).sum((1, 2))
    torch.testing.assert_close(LightProbe.open(file(picture), height=rows).total_power, power, rtol=3e-7, atol=0)


@pytest.mark.parametrize("height", [2, 9, 64])
def test_bands_of_one_value_stay_one(file, height):
    probe = LightProbe.open(file(torch.full((3, height, 2 * height), 0.7)))
    torch.testing.assert_close(probe.radiance, torch.full_like(probe.radiance, 0.7), rtol=4e-7, atol=0)


@pytest.mark.parametrize(("row", "column"), [(0, 5), (1, 100), (20, 0), (31, 64), (32, 127), (50, 30), (63, 77)])
def test_a_texel_lies_in_the_middle_of_its_cell(file, row, column):
    """Within a twentieth of it; read from pole to pole it is up to half of it off."""
    picture = torch.zeros(3, 64, 128)
    picture[:, row, column] = 1e4
    inside = (torch.arange(200, dtype=torch.float64) + 0.5) / 200
    theta = (row + inside) * (math.pi / 64)
    lower = float((theta * theta.sin()).sum() / theta.sin().sum())  # beside a pole most of the area is farther from it
    direction = towards(lower, 2 * math.pi * (column + 0.5) / 128)
    found = mean_direction(LightProbe.open(file(picture)))
    assert math.degrees(torch.acos((found @ direction).clamp(max=1))) < 180 / 64 / 20
    if row in (0, 1, 20, 50, 63):
        off = mean_direction(LightProbe.open(file(picture), rows="poles"))
        assert math.degrees(torch.acos((off @ direction).clamp(max=1))) > 0.4


def test_rows_are_asked_for_and_said(file):
    path = file(noise(8, 16))
    usual, centres, poles = (LightProbe.open(path, height=8, rows=rows) for rows in (None, "centres", "poles"))
    assert usual.reading == centres.reading == "rows at pixel centres"
    assert usual.fingerprint == centres.fingerprint
    assert poles.reading == "rows from pole to pole"
    assert usual.scaled(2).reading == "rows at pixel centres"
    assert LightProbe.default(8).reading == ""


def test_rows_from_pole_to_pole_are_what_is_stored(file):
    picture = noise(16, 32)
    probe = LightProbe.open(file(picture), rows="poles")
    assert torch.equal(probe.radiance, picture)
    assert torch.equal(LightProbe.open(file(picture), rows="poles", height=16).radiance, picture)
    assert torch.equal(LightProbe.open(file(picture), rows="poles", height=9).radiance, probe.resized(9).radiance)


@pytest.mark.parametrize(("height", "expected"), [(8, 512), (64, 512), (100, 600), (256, 512), (512, 512), (700, 700)])
def test_bands_are_cut_into_whole_parts(file, height, expected):
    assert LightProbe.open(file(torch.ones(3, height, 2 * height))).height == expected


def test_a_coarse_probe_lights_as_its_cells_do(file):
    """Bilinear at its own height, a lamp of one texel would be as wide as two in either axis."""
    picture = torch.zeros(3, 32, 64)
    picture[:, 12, 20] = 1
    probe = LightProbe.open(file(picture))
    step = math.pi / 32
    inside = towards(step * 12.9, step * 20.9)
    outside = towards(step * 13.1, step * 20.5), towards(step * 12.5, step * 21.1)
    assert float(probe.radiance_at(inside.float())[0]) == pytest.approx(1, abs=1e-5)
    assert [float(probe.radiance_at(d.float())[0]) for d in outside] == pytest.approx([0, 0], abs=1e-5)


def test_own_files_say_how_their_rows_lie(tmp_path):
    probe = LightProbe(noise(16, 32))
    probe.save(tmp_path / "ours.exr")
    again = LightProbe.open(tmp_path / "ours.exr")
    assert again.fingerprint == probe.fingerprint
    assert again.reading == "rows from pole to pole, as the file says"
    assert LightProbe.open(tmp_path / "ours.exr", rows="centres").fingerprint != probe.fingerprint
    assert torch.equal(read_image(tmp_path / "ours.exr"), probe.radiance)


def test_own_files_are_exr(tmp_path):
    message = f"{tmp_path / 'x.hdr'}: a light probe is saved as .exr, which can say how its rows lie; name it .exr"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        LightProbe.default(8).save(tmp_path / "x.hdr")


def test_environment_maps_of_openexr_run_from_edge_to_edge(tmp_path):
    """Pixel (x, y) has the longitude pi - 2 pi x / (W - 1) from +Z to +X and the latitude pi / 2 - pi y / (H - 1)."""
    height, width = 64, 128
    latitude = math.pi / 2 - math.pi * torch.arange(height) / (height - 1)
    longitude = math.pi - 2 * math.pi * torch.arange(width) / (width - 1)
    across, forward = (latitude.cos()[:, None] * f(longitude) for f in (torch.sin, torch.cos))
    directions = torch.stack([across, latitude.sin()[:, None].expand(height, width), forward], dim=-1)
    write_envmap(tmp_path / "map.exr", scene(directions), OpenEXR.ENVMAP_LATLONG)
    probe = LightProbe.open(tmp_path / "map.exr")
    assert probe.reading == "rows from pole to pole and columns from edge to edge, as its envmap attribute says"
    assert float((probe.radiance - scene(texel_directions(64))).abs().max()) < 2e-3
    without = LightProbe.open(tmp_path / "map.exr", rows="poles")
    assert float((without.radiance - scene(texel_directions(64))).abs().max()) > 0.02


# --- Discs -----------------------------------------------------------------------------------------------


def ball(size: tuple[int, int], circle: tuple[float, float, float], outside: float = math.nan) -> Tensor:
    """A photograph of a mirror ball in the scene, with something else around it."""
    x, y, radius = circle
    v, u = torch.meshgrid(
        (y - torch.arange(size[0]) - 0.5) / radius, (torch.arange(size[1]) + 0.5 - x) / radius, indexing="ij"
    )
    n = torch.stack([u, v, (1 - u * u - v * v).clamp_min(0).sqrt()], dim=-1)
    reflected = 2 * n[..., 2:] * n - torch.tensor([0.0, 0.0, 1.0])
    return torch.where(torch.hypot(u, v) <= 1, scene(reflected), outside)


LOOSE = ((90, 140), (80.3, 42.7, 33.4))


def difference(probe: LightProbe) -> float:
    """From the scene: mean over the sphere, relative."""
    expected = scene(texel_directions(probe.height))
    off = ((probe.radiance - expected).abs() * probe.solid_angles).sum()
    return float(off / (expected * probe.solid_angles).sum())


def test_a_disc_is_taken_where_the_circle_is(file):
    size, circle = LOOSE
    path = file(ball(size, circle))
    probe = LightProbe.open(path, "mirror_ball", height=64, circle=circle)
    assert difference(probe) < 0.01
    assert probe.reading == "mirror ball, disc around (80.3, 42.7) of radius 33.4 pixels"
    # To a fraction of a pixel: half of one is seen.
    x, y, radius = circle
    assert difference(LightProbe.open(path, "mirror_ball", height=64, circle=(x + 0.5, y, radius - 0.6))) > 0.012


def test_a_tight_crop_needs_no_circle(file):
    tight = LightProbe.open(file(ball((64, 64), (32, 32, 32))), "mirror_ball", height=32)
    same = LightProbe.open(file(ball((64, 64), (32, 32, 32))), "mirror_ball", height=32, circle=(32, 32, 32))
    loose = LightProbe.open(file(ball((80, 100), (52, 42, 32))), "mirror_ball", height=32, circle=(52, 42, 32))
    assert torch.equal(tight.radiance, same.radiance)
    torch.testing.assert_close(loose.radiance, tight.radiance, rtol=0, atol=2e-4)


def test_discs_are_as_fine_as_their_pixels_and_never_coarse(file, monkeypatch):
    assert LightProbe.open(file(ball((40, 40), (20, 20, 20))), "mirror_ball").height == 512
    monkeypatch.setattr("torchbrdf.light._picture.LEAST_HEIGHT", 64)
    assert LightProbe.open(file(torch.ones(3, 120, 120)), "angular").height == 64
    assert LightProbe.open(file(torch.ones(3, 200, 200)), "angular").height == 100


@pytest.mark.parametrize("given", [0.5, 1, (0.5,), (0.4, 0.5, 1.0)])
def test_what_a_ball_does_not_reflect_is_put_back(file, given):
    factor = torch.tensor(given if isinstance(given, tuple) else [given])[:, None, None]
    path = file(ball((48, 48), (24, 24, 24)))
    whole = LightProbe.open(path, "mirror_ball", height=24).radiance
    found = LightProbe.open(path, "mirror_ball", height=24, reflectance=given)
    torch.testing.assert_close(found.radiance, whole / factor)
    numbers = " ".join(f"{each:g}" for each in factor.ravel().tolist())
    assert found.reading.endswith(f", reflectance {numbers}")


@pytest.mark.parametrize("given", [0, -0.5, 60, math.nan, (0.5, 0.5), (0.5, 0.5, 2.0)])
def test_reflectances_are_shares(file, given):
    with pytest.raises(ValueError, match=r"^--mirror-reflectance .* one or three numbers above 0 and at most 1, got "):
        LightProbe.open(file(ball((48, 48), (24, 24, 24))), "mirror_ball", reflectance=given)


def test_a_mask_with_a_hole_needs_repair(file):
    """What the stand hides is not known: filled from around it, and said."""
    size, circle = LOOSE
    picture = ball(size, circle)
    mask = torch.isfinite(picture).all(0, keepdim=True)
    mask[0, 60:64, 78:83] = False
    picture[:, 60:64, 78:83] = math.inf
    path = file(picture)
    message = r"the mask leaves out 0\.6 % of the sphere; rows 60 to 63, columns 78 to 82, counted from 0"
    with pytest.raises(ValueError, match=message + r"; give --repair-probe \(repair=True in Python\)"):
        LightProbe.open(path, "mirror_ball", circle=circle, mask=mask)
    with pytest.warns(UserWarning, match=message + "; filled from around it$") as caught:
        probe = LightProbe.open(path, "mirror_ball", True, 64, circle=circle, mask=mask)
    assert [warning.filename for warning in caught] == [__file__]
    assert difference(probe) < 0.01


def test_a_mask_may_be_drawn_a_pixel_too_small(file):
    size, circle = LOOSE
    mask = torch.isfinite(ball(size, (*circle[:2], circle[2] - 1))).all(0, keepdim=True)
    probe = LightProbe.open(file(ball(size, circle)), "mirror_ball", height=64, circle=circle, mask=mask)
    assert difference(probe) < 0.012


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"circle": (20, 20, 30)}, "a disc around (20, 20) of radius 30 does not lie in a picture of 90 x 140; give"),
        ({"circle": (70, 45, 1)}, "a disc around (70, 45) of radius 1 does not lie in a picture of 90 x 140; give"),
        ({"circle": (70, math.nan, 9)}, "a disc around (70, nan) of radius 9 does not lie in a picture of 90 x 140;"),
        ({}, "must be square, got 90 x 140; crop it to the disc, or say where the disc is: --probe-circle X Y R"),
        ({"circle": (70, 45, 9), "mask": torch.ones(1, 9, 9) > 0}, "the mask must be as large as the picture, (1, 90,"),
        ({"circle": (70, 45, 9), "mask": torch.zeros(1, 90, 140) > 0}, "the mask leaves no pixel of the disc"),
    ],
)  # fmt: skip
def test_bad_discs(file, options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        LightProbe.open(file(torch.ones(3, 90, 140)), "mirror_ball", **options)


@pytest.mark.parametrize(
    ("layout", "options", "message"),
    [
        ("latlong", {"circle": (8, 8, 8)}, "--probe-circle (circle= in Python) goes with --probe-layout mirror_ball"),
        ("vertical_cross", {"mask": torch.ones(1, 8, 16) > 0}, "--probe-mask (mask= in Python) goes with --probe-"),
        ("angular", {"reflectance": 0.5}, "--mirror-reflectance (reflectance= in Python) goes with --probe-layout"),
        ("angular", {"rows": "poles"}, "--probe-rows (rows= in Python) goes with --probe-layout latlong (layout="),
        ("latlong", {"rows": "middle"}, "rows must be one of centres, poles, got 'middle'"),
    ],
)
def test_options_of_other_layouts(file, layout, options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        LightProbe.open(file(torch.ones(3, 8, 16)), layout, **options)


# --- Cubes -----------------------------------------------------------------------------------------------


def face(side: int, right: str, down: str, front: str, to_edges: bool = False) -> Tensor:
    """The scene on a face, seen from inside."""
    axes = {name: torch.eye(3)[k] * sign for k, a in enumerate("XYZ") for sign, name in ((1, f"+{a}"), (-1, f"-{a}"))}
    at = torch.linspace(-1, 1, side) if to_edges else (2 * torch.arange(side) + 1) / side - 1
    points = at[None, :, None] * axes[right] + at[:, None, None] * axes[down] + axes[front]
    return scene(torch.nn.functional.normalize(points, dim=-1))


def cross(side: int, cells: dict[tuple[int, int], Tensor], rows: int, columns: int) -> Tensor:
    picture = torch.full((3, rows * side, columns * side), math.nan)
    for (row, column), one in cells.items():
        picture[:, row * side : (row + 1) * side, column * side : (column + 1) * side] = one
    return picture


def middle_of_a_cross(side: int) -> dict[tuple[int, int], Tensor]:
    """Whoever looks forward, along -Z, has -X on the left and +X on the right."""
    return {
        (0, 1): face(side, "+X", "-Z", "+Y"),
        (1, 0): face(side, "-Z", "-Y", "-X"),
        (1, 1): face(side, "+X", "-Y", "-Z"),
        (1, 2): face(side, "+Z", "-Y", "+X"),
        (2, 1): face(side, "+X", "+Z", "-Y"),
    }


def test_vertical_crosses(file):
    """Between the faces may stand anything; edges that meet in the picture show the same."""
    picture = cross(32, middle_of_a_cross(32) | {(3, 1): face(32, "+X", "+Y", "+Z")}, 4, 3)
    probe = LightProbe.open(file(picture), "vertical_cross")
    assert probe.reading == "vertical cross, faces of 32 x 32 pixels"
    assert float((probe.radiance - scene(texel_directions(512))).abs().max()) < 0.06  # a pixel is 3.6 degrees across
    assert difference(probe) < 0.012
    torch.testing.assert_close(probe.mean_radiance, torch.full((3,), 1.5, dtype=torch.float64), rtol=1e-3, atol=0)


def test_horizontal_crosses(file):
    picture = cross(32, middle_of_a_cross(32) | {(1, 3): face(32, "-X", "-Y", "+Z")}, 3, 4)
    probe = LightProbe.open(file(picture), "horizontal_cross", height=128)
    assert float((probe.radiance - scene(texel_directions(128))).abs().max()) < 0.06
    # Neighbouring faces show one edge: the picture is one strip of a panorama.
    assert float((picture[:, 32:64, 95] - picture[:, 32:64, 96]).abs().max()) < 0.08


def test_a_cross_holds_the_light_of_a_latlong(file, tmp_path):
    """Looked up in a known probe, and back."""
    known = LightProbe.default(256)
    side, axes = 128, torch.eye(3)
    at = (2 * torch.arange(side) + 1) / side - 1

    def seen(right: Tensor, down: Tensor, front: Tensor) -> Tensor:
        points = at[None, :, None] * right + at[:, None, None] * down + front
        return known.radiance_at(torch.nn.functional.normalize(points, dim=-1)).permute(2, 0, 1)

    x, y, z = axes
    cells = {(0, 1): seen(x, -z, y), (1, 0): seen(-z, -y, -x), (1, 1): seen(x, -y, -z), (1, 2): seen(z, -y, x)}
    cells |= {(2, 1): seen(x, z, -y), (3, 1): seen(x, y, z)}
    again = LightProbe.open(file(cross(side, cells, 4, 3)), "vertical_cross", height=64)
    expected = known.resized(64)
    error = float((again.radiance - expected.radiance).norm() / expected.radiance.norm())
    mirrored = float((again.radiance.flip(2) - expected.radiance).norm() / expected.radiance.norm())
    assert error < 0.05
    assert mirrored > 0.5


@pytest.mark.parametrize("said", ["by the file", "by the layout"])
def test_environment_cubes_of_openexr(tmp_path, file, said):
    faces = [("+Z", "-Y", "+X"), ("-Z", "-Y", "-X"), ("+X", "-Z", "+Y"), ("+X", "+Z", "-Y"), ("-X", "-Y", "+Z")]
    faces += [("+X", "-Y", "-Z")]
    picture = torch.cat([face(33, *axes, to_edges=True) for axes in faces], dim=1)
    if said == "by the file":
        write_envmap(tmp_path / "cube.exr", picture, OpenEXR.ENVMAP_CUBE)
        probe = LightProbe.open(tmp_path / "cube.exr", height=128)
    else:
        probe = LightProbe.open(file(picture), "envmap_cube", height=128)
    assert probe.reading == "envmap cube, faces of 33 x 33 pixels"
    assert float((probe.radiance - scene(texel_directions(128))).abs().max()) < 0.06


@pytest.mark.parametrize(
    ("size", "looks"),
    [
        ((40, 30), "it looks like a vertical cross of a cube: give --probe-layout vertical_cross"),
        ((30, 40), "it looks like a horizontal cross of a cube, or a whole photograph of a mirror ball: give "
         "--probe-layout horizontal_cross, or --probe-layout mirror_ball with --probe-circle X Y R"),
        ((60, 10), "it looks like the faces of a cube, one below the other: give --probe-layout envmap_cube where"),
        ((10, 60), "it looks like the faces of a cube, side by side, of which programs have different orders: convert"),
        ((10, 10), "it looks like a mirror ball or an angular map: give --probe-layout mirror_ball or --probe-layout"),
        ((10, 21), "crop or convert it; for a photograph of a mirror ball give --probe-layout mirror_ball with"),
    ],
)  # fmt: skip
def test_other_pictures_are_named(file, size, looks):
    message = f"must be lat-long (width = 2 x height), got {size[0]} x {size[1]}; {looks}"
    with pytest.raises(ValueError, match=re.escape(message)):
        LightProbe.open(file(torch.ones(3, *size)))


def test_cubes_have_their_proportions(file):
    with pytest.raises(ValueError, match=r", must be 4 faces high and 3 wide, got 30 x 40 pixels$"):
        LightProbe.open(file(torch.ones(3, 30, 40)), "vertical_cross")


# --- Values ----------------------------------------------------------------------------------------------


def test_holes_of_a_file_are_filled_before_its_rows_are_cut(file):
    picture = torch.ones(3, 8, 16)
    picture[:, 3, 4] = math.nan
    path = file(picture)
    message = r"probe\.exr has 1 NaN texel of 128 \(1\.2 % of the sphere; row 3, column 4, counted from 0\)"
    with pytest.raises(ValueError, match=message + "; give --repair-probe"):
        LightProbe.open(path)
    with pytest.warns(UserWarning, match=message + "; filled from their neighbours$") as caught:
        assert LightProbe.open(path, repair=True).radiance.unique().tolist() == pytest.approx([1])
    assert [warning.filename for warning in caught] == [__file__]


@pytest.mark.parametrize("layout", ["latlong", "vertical_cross", "mirror_ball"])
def test_infinite_texels_of_a_file(file, layout):
    picture = torch.ones(3, *{"latlong": (8, 16), "vertical_cross": (16, 12), "mirror_ball": (16, 16)}[layout])
    picture[1, 6, 7] = math.inf
    with pytest.raises(ValueError, match=r"has 1 infinite texel of \d+ \(row 6, column 7, counted from 0\): a lamp"):
        LightProbe.open(file(picture), layout, repair=True)


@pytest.mark.parametrize("rows", ["centres", "poles"])
def test_the_largest_half_float_is_said_once(file, rows):
    picture = torch.ones(3, 8, 16)
    picture[:, 3, 4] = 65504
    with pytest.warns(UserWarning, match=r"probe\.exr has 1 texel of exactly 65504") as caught:
        LightProbe.open(file(picture), rows=rows)
    assert len(caught) == 1


def test_a_png_is_no_probe(tmp_path):
    write_image(tmp_path / "p.png", torch.ones(3, 8, 16))
    with pytest.raises(ValueError, match=r"p\.png: 8-bit PNG is not linear HDR; give an .exr or .hdr image; "):
        LightProbe.open(tmp_path / "p.png")
