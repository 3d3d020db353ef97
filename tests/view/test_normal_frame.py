"""Maps whose Y points down, or Z away: turned where slopes and silhouette say so with certainty, never by noise."""

import warnings

import pytest
import torch
from torch.nn.functional import normalize

from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView

Y_DOWN = "normal map: its normals have Y down and were turned to Y up"


def of_height(size, height, inside=None):
    """(3, size, size) unit normals of z = height(x, y), x right and y up in [-1, 1]; 0 where not inside(x, y)."""
    steps = (torch.arange(size, dtype=torch.float64) + 0.5) / size * 2 - 1
    y, x = (axis.clone().requires_grad_() for axis in torch.meshgrid(-steps, steps, indexing="ij"))
    p, q = torch.autograd.grad(height(x, y).sum(), (x, y), materialize_grads=True)
    normals = normalize(torch.stack([-p, -q, torch.ones_like(p)]), dim=0).float()
    return normals if inside is None else torch.where(inside(x.detach(), y.detach()), normals, 0)


def dome(x, y, a=0.95, b=0.95):
    return (1 - (x / a) ** 2 - (y / b) ** 2).clamp_min(1e-6).sqrt()


def disc(x, y):
    return x * x + y * y < 0.87


def turned(x, y):
    return 0.8 * x + 0.6 * y, -0.6 * x + 0.8 * y


SHAPES = {
    "ball": (dome, disc),
    "ellipsoid": (lambda x, y: dome(*turned(x, y), 0.9, 0.5), lambda x, y: dome(*turned(x, y), 0.9, 0.5) > 0.2),
    "diagonal cylinder": (lambda x, y: (1 - (x + y) ** 2 / 2).clamp_min(1e-6).sqrt(), lambda x, y: (x + y).abs() < 1.3),
    "hills": (lambda x, y: 0.2 * torch.sin(5 * x) * torch.cos(4 * y + 1), None),
    "peaks": (lambda x, y: torch.exp(-8 * ((x - 0.3) ** 2 + y**2)) - torch.exp(-9 * (x + y - 0.1) ** 2), None),
    "saddle": (lambda x, y: 2 * x * y, disc),
}
UNDECIDED = {
    "bowl": (lambda x, y: -dome(x, y), disc),
    "cylinder": (lambda x, y: dome(x, 0 * y), lambda x, y: x.abs() < 0.9),
    "lying cylinder": (lambda x, y: dome(0 * x, y), lambda x, y: y.abs() < 0.9),
    "trough": (lambda x, y: -dome(0 * x, y), lambda x, y: y.abs() < 0.9),
    "plane": (lambda x, y: 0.05 * x + 0.1 * y, None),
    "nearly flat": (lambda x, y: 0.02 * x * x * y, None),
    "upright saddle": (lambda x, y: y * y - x * x, disc),
    "paraboloid": (lambda x, y: -x * x - y * y, disc),
    "corner of a bowl": (lambda x, y: -0.3 * (x - 1) ** 2 - 0.3 * (y + 1) ** 2, None),
    "two waves": (lambda x, y: 0.3 * torch.sin(4 * x) + 0.3 * torch.cos(5 * y), None),
}


def noisy(normals, level, seed=0):
    noise = level * torch.randn(normals.shape, generator=torch.Generator().manual_seed(seed))
    shaken = normalize(normals + noise, dim=0)
    return torch.where((normals != 0).any(0) & (shaken[2] > 0), shaken, 0)


def in_frame(normals, *signs):
    return normals * torch.tensor(signs, dtype=torch.float32)[:, None, None]


def read(normals, **arguments):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        view = NormalMapView(normals, **arguments)
    return view, [str(warning.message) for warning in caught]


@pytest.mark.parametrize("size", [24, 64, 200])
@pytest.mark.parametrize("shape", SHAPES)
def test_maps_with_y_down_are_turned_and_that_is_said(shape, size):
    normals = of_height(size, *SHAPES[shape])
    view, said = read(in_frame(normals, 1, -1, 1))
    assert said == [Y_DOWN]
    torch.testing.assert_close(view.normals, normals)


@pytest.mark.parametrize("size", [8, 24, 64])
def test_a_ball_with_y_down_encoded_in_8_bits(size):
    sphere = SphereView(size)
    numbers = ((in_frame(sphere.normals, 1, -1, 1) / 2 + 0.5) * 255).round() / 255
    view, said = read(torch.where(sphere.mask, numbers, 0))
    assert len(said) == 2
    assert said[1] == Y_DOWN
    assert float((view.normals - sphere.normals).abs().max()) < 0.01


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_noise_does_not_hide_y_down_in_a_large_map(noise):
    normals = noisy(of_height(200, *SHAPES["ball"]), noise)
    view, said = read(in_frame(normals, 1, -1, 1))
    assert said == [Y_DOWN]
    torch.testing.assert_close(view.normals, normals)


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("size", [8, 13, 24, 64, 150])
@pytest.mark.parametrize("shape", [*SHAPES, *UNDECIDED])
def test_right_maps_are_never_turned(shape, size, noise):
    normals = noisy(of_height(size, *(SHAPES | UNDECIDED)[shape]), noise, seed=size)
    view, said = read(normals)
    torch.testing.assert_close(view.normals, torch.where(normals[2] > 0, normals, 0))
    assert all("taken as Y up" in each for each in said)


@pytest.mark.parametrize("seed", range(20))
def test_noise_alone_turns_nothing(seed):
    normals = noisy(torch.tensor([0.0, 0.0, 1.0])[:, None, None].repeat(1, 10 + seed, 30 - seed), 0.2, seed)
    view, said = read(normals)
    assert said == []
    torch.testing.assert_close(view.normals, normals)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("bits", [None, 8])
def test_right_maps_of_clear_shapes_are_silent(shape, bits):
    normals = of_height(64, *SHAPES[shape])
    numbers = normals if bits is None else (normals / 2 + 0.5).mul(255).round() / 255
    assert not any("Y" in each for each in read(torch.where((normals != 0).any(0), numbers, 0))[1])


@pytest.mark.parametrize("shape", ["lying cylinder", "trough", "paraboloid"])
def test_what_a_hollow_shape_or_y_down_would_show_alike_is_kept_and_said(shape):
    normals = of_height(48, *UNDECIDED[shape])
    normals = normals if shape == "trough" else in_frame(normals, 1, -1, 1)
    view, said = read(normals)
    torch.testing.assert_close(view.normals, normals)
    assert "hollow, or Y down; taken as Y up" in said[0]


def test_slopes_that_fit_neither_frame_of_the_silhouette_are_refused():
    with pytest.raises(ValueError, match=r"slopes do not fit together with Y up.*expected unit normals with X right"):
        NormalMapView(in_frame(of_height(48, *UNDECIDED["bowl"]), 1, -1, 1))


@pytest.mark.parametrize("fov", [20.0, 60.0])
def test_a_perspective_camera(fov):
    sphere = SphereView(40, fov_deg=fov)
    arguments = {"mask": sphere.mask, "view_dirs": sphere.view_dirs}
    assert read(sphere.normals, **arguments)[1] == []
    view, said = read(in_frame(sphere.normals, 1, -1, 1), **arguments)
    assert said == [Y_DOWN]
    torch.testing.assert_close(view.normals, sphere.normals)


@pytest.mark.parametrize(("signs", "said"), [((1, 1, -1), "have Z into the scene"), ((1, -1, -1), "have Y down and Z")])
def test_z_into_the_scene_is_turned_where_the_silhouette_says_so(signs, said):
    sphere = SphereView(32)
    view, notes = read(in_frame(sphere.normals, *signs))
    assert said in notes[0]
    torch.testing.assert_close(view.normals, sphere.normals)


@pytest.mark.parametrize("signs", [(-1, -1, -1), (-1, 1, -1)])
def test_other_frames_behind_the_camera_are_refused(signs):
    with pytest.raises(ValueError, match="faces the camera; expected unit normals with X right, Y up and Z towards"):
        NormalMapView(in_frame(SphereView(32).normals, *signs))


def test_z_into_the_scene_without_a_silhouette_is_refused():
    with pytest.raises(ValueError, match="no pixel under the mask has a normal that faces the camera; expected"):
        NormalMapView(in_frame(of_height(32, *SHAPES["hills"]), 1, 1, -1))


@pytest.mark.parametrize("order", [(0, 2, 1), (2, 1, 0), (2, 0, 1)])
@pytest.mark.parametrize("encoded", [False, True])
def test_other_axes_are_refused(order, encoded):
    """The world's Z up, or channels B, G, R."""
    sphere = SphereView(32)
    normals = sphere.normals[list(order)]
    numbers = torch.where(sphere.mask, normals / 2 + 0.5, 0) if encoded else normals
    with pytest.raises(ValueError, match=r"5\d% of its normals face away from the camera, .*expected unit normals"):
        NormalMapView(numbers)


def test_a_flat_wall_around_a_ball_is_left_out_and_one_with_a_low_relief_is_not():
    sphere = SphereView(32)
    facing = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    view, said = read(torch.where(sphere.mask, sphere.normals, facing))
    assert torch.equal(view.mask, sphere.mask)
    n_around = 32 * 32 - len(sphere.pixels)
    assert said == [f"normal map: {n_around} pixels around the shape that face the camera were left out"]
    relief = torch.where(sphere.mask, normalize(sphere.normals + 3 * facing, dim=0), facing)
    view, said = read(relief)
    assert view.mask.all()
    assert said == []
