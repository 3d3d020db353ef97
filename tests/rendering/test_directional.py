import re
from math import pi, radians, sin

import pytest
import torch

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.rendering.directional import directional_pictures, render_directional, to_local
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView


def lambertian(albedo=(1.0, 0.5, 0.25)):
    colour = torch.tensor(albedo, dtype=torch.float64) / pi
    return MerlTable.from_function(lambda w_i, w_o: colour.expand(*w_i.shape[:-1], 3), "lambertian")


@pytest.fixture(scope="module")
def matte():
    return lambertian()


def one_pixel(normal, view_dir=(0.0, 0.0, 1.0)):
    shaped = (torch.tensor(vector)[:, None, None] for vector in (normal, view_dir))
    normals, view_dirs = shaped
    return NormalMapView(normals, view_dirs=view_dirs)


def test_a_white_sphere_lit_from_the_camera_shows_the_mean_cosine_of_each_pixel(matte):
    view = SphereView(16)
    image = render_directional(matte, view, 0.0, irradiance=pi, subpixels=8)
    edges = torch.linspace(-1, 1, 16 * 64 + 1, dtype=torch.float64)
    middle = (edges[1:] + edges[:-1]) / 2
    z = torch.sqrt((1 - middle[:, None] ** 2 - middle**2).clamp_min(0))
    expected = z.reshape(16, 64, 16, 64).mean((1, 3)) * view.mask[0]
    assert torch.allclose(image[0].double(), expected, atol=2e-3)
    assert torch.allclose(image[1], 0.5 * image[0])
    assert torch.allclose(image[2], 0.25 * image[0])
    assert (image[:, ~view.mask[0]] == 0).all()


def test_it_returns_f_r_times_the_cosine():
    table = MerlTable.from_function(
        lambda w_i, w_o: (0.1 + 0.5 * w_i[..., 2:] * w_o[..., 2:]) * torch.tensor([1.0, 2.0, 3.0])
    )
    normal = torch.nn.functional.normalize(torch.tensor([0.3, -0.2, 0.8], dtype=torch.float64), dim=0)
    light = torch.nn.functional.normalize(torch.tensor([0.7, 0.4, 0.5], dtype=torch.float64), dim=0)
    cos_i, cos_o = float(normal @ light), float(normal[2])
    image = render_directional(table, one_pixel(normal.tolist()), direction=3 * light)
    expected = (0.1 + 0.5 * cos_i * cos_o) * cos_i * torch.tensor([1.0, 2.0, 3.0])
    assert torch.allclose(image[:, 0, 0], expected.float(), rtol=5e-3)


def test_several_tables_look_as_each_does_alone(matte):
    gloss = MerlTable.from_function(lambda w_i, w_o: (w_i[..., 2:] * w_o[..., 2:] ** 2).expand(*w_i.shape[:-1], 3))
    view = SphereView(24)
    pictures = directional_pictures([matte, gloss], view, 60.0, irradiance=2.0)
    for picture, table in zip(pictures, (matte, gloss), strict=True):
        assert torch.equal(picture, render_directional(table, view, 60.0, irradiance=2.0))


def test_the_angle_turns_about_y_towards_image_right(matte):
    view = SphereView(32)
    lit = {angle: render_directional(matte, view, angle)[0] for angle in (-90.0, 90.0, 136.0)}
    assert (lit[90.0][:, :16] == 0).all()
    assert lit[90.0][:, 16:].sum() > 0
    assert torch.allclose(lit[-90.0], lit[90.0].flip(1), atol=1e-6)
    assert torch.allclose(lit[90.0], lit[90.0].flip(0), atol=1e-6)
    columns = lit[136.0][15] > 0
    dark_until = 16 * (1 + sin(radians(136 - 90)))  # the terminator crosses the equator at x = sin 46 degrees
    assert not columns[: int(dark_until)].any()
    assert columns[int(dark_until) : 30].all()


def test_the_highlight_lies_at_the_half_vector():
    def shiny(w_i, w_o):
        h = torch.nn.functional.normalize(w_i + w_o, dim=-1)
        return torch.exp(-(1 - h[..., 2:].clamp_max(1)) / 1e-3).expand(*w_i.shape[:-1], 3)

    image = render_directional(MerlTable.from_function(shiny), SphereView(64), 60.0)
    row, column = divmod(int(image[0].argmax()), 64)
    assert row in (31, 32)
    assert column == pytest.approx(32 * (1 + sin(radians(30))) - 0.5, abs=1)


def test_angle_and_direction_agree_and_irradiance_scales(matte):
    view = SphereView(12)
    by_angle = render_directional(matte, view, 40.0)
    direction = torch.tensor([sin(radians(40.0)), 0.0, sin(radians(50.0))])
    assert torch.allclose(render_directional(matte, view, direction=direction), by_angle, atol=1e-6)
    assert torch.allclose(render_directional(matte, view, 40.0, irradiance=2.5), 2.5 * by_angle)


@pytest.mark.parametrize(
    "normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0.0, 0.8), (0.3, -0.9, 0.1), (0.1, 0.2, -0.9)]
)
def test_the_local_frame_is_a_rotation_with_the_normal_up(normal):
    normal = torch.nn.functional.normalize(torch.tensor(normal, dtype=torch.float64), dim=0)
    rotation = to_local(normal.expand(3, 3), torch.eye(3, dtype=torch.float64)).T
    assert torch.allclose(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), atol=1e-12)
    assert float(torch.linalg.det(rotation)) == pytest.approx(1)
    assert torch.allclose(rotation @ normal, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64), atol=1e-12)


def test_a_camera_at_the_other_side_sees_the_same(matte):
    image = render_directional(matte, one_pixel((0.0, 0.0, -1.0), (0.0, 0.0, -1.0)), 180.0, irradiance=pi)
    assert float(image[0, 0, 0]) == pytest.approx(1, rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "give either angle_deg or direction for the light, and not both"),
        (
            {"angle_deg": 0.0, "direction": torch.ones(3)},
            "give either angle_deg or direction for the light, and not both",
        ),
        ({"direction": torch.zeros(3)}, "direction of the light must be finite and not zero, got [0.0, 0.0, 0.0]"),
        ({"direction": torch.ones(2)}, "direction of the light must be (3,), got (2,)"),
        ({"angle_deg": float("nan")}, "angle_deg must be finite, got nan"),
        ({"angle_deg": 0.0, "irradiance": 0.0}, "irradiance must be positive and finite, got 0.0"),
        ({"angle_deg": 0.0, "subpixels": 0}, "subpixels must be at least 1, got 0"),
        ({"angle_deg": 0.0, "subpixels": 1.5}, "subpixels must be a whole number, got 1.5"),
    ],
)
def test_bad_arguments(matte, arguments, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        render_directional(matte, SphereView(8), **arguments)
