"""Turned probes and hidden pixels: closed forms, brute force, and behaviour inside kornia's containers."""

import math
import warnings
from pathlib import Path

import pytest
import torch
from kornia.augmentation import AugmentationSequential
from kornia.geometry.conversions import axis_angle_to_rotation_matrix
from torch import Tensor

from torchbrdf import LightProbe, SphereView
from torchbrdf.images.difference import relative_rms
from torchbrdf.learning.augment import (
    RandomDropout,
    RandomExposure,
    RandomFlicker,
    RandomOccluders,
    RandomProbeRotation,
    RandomReflection,
    RandomSaturation,
    RandomSensorNoise,
    RandomSilhouetteErosion,
    RandomStand,
    draw_occluders,
    erode_silhouette,
    flicker,
    mask_reflection,
    mask_saturated,
    mask_stand,
    photograph_defects,
    pixel_grid,
    random_rotations,
    rotate_probes,
    sensor_noise,
)
from torchbrdf.light.latlong import directions_at, row_solid_angles
from torchbrdf.transport.harmonic.light import TurningLight

PROBES = ("apartment.exr", "venice.exr", "forest.exr", "dawn.exr", "uffizi.hdr", "grace.hdr", "ennis.hdr")
SIZE = 32
VIEW = SphereView(SIZE)


def turn(degrees: float, axis: tuple[float, float, float]) -> Tensor:
    direction = torch.tensor([axis], dtype=torch.float64)
    return axis_angle_to_rotation_matrix(math.radians(degrees) * direction / direction.norm())[0]


def power(radiance: Tensor) -> Tensor:
    weights = row_solid_angles(radiance.shape[-2], radiance.shape[-1])[:, None]
    return (radiance.double() * weights).sum((-2, -1))


def lamp(height: int, row: int, column: int) -> Tensor:
    radiance = torch.full((3, height, 2 * height), 0.01)
    radiance[:, row, column] = 1000
    return radiance


# --- probes ---


def test_turns_as_light_probe_does():
    probe = LightProbe.default(32)
    rotations = random_rotations(3)
    found = rotate_probes(probe.radiance, rotations, keep_power=False)
    assert found.shape == (3, 3, 32, 64)
    for turned, rotation in zip(found, rotations, strict=True):
        assert relative_rms(turned, probe.rotated(rotation).radiance) < 1e-5


def test_light_that_is_linear_in_the_direction():
    """L(d) = 2 + b . d becomes 2 + (R b) . d, in every texel, poles and seam included."""
    height = 96
    y, x = torch.meshgrid(torch.arange(height), torch.arange(2 * height), indexing="ij")
    d = directions_at(x, y, height, 2 * height)
    b = torch.tensor([0.3, -0.9, 0.5])
    rotation = turn(77, (0.2, -1, 0.4)).float()
    error = (rotate_probes((2 + d @ b)[None], rotation)[0] - (2 + d @ (rotation @ b))).abs().amax(1)
    assert float(error[[1, -2]].max()) < 2.5e-3  # their footprints keep the power of lamps there, off their centres
    error[[1, -2]] = 0
    assert float(error.max()) < 1.5e-3


def test_a_constant_stays_constant():
    constant = torch.full((3, 16, 32), 2.5)
    found = rotate_probes(constant, random_rotations(5))
    torch.testing.assert_close(found, constant.expand(5, -1, -1, -1), rtol=1e-6, atol=0)


def test_seam():
    """A turn about the vertical by whole texels only rolls: the seam is no place."""
    probe = lamp(16, 7, 31)
    still = rotate_probes(probe, torch.eye(3))
    for texels in (1, 5, 20):
        found = rotate_probes(probe, turn(-360 * texels / 32, (0, 1, 0)))
        torch.testing.assert_close(found, still.roll(texels, -1), rtol=1e-3, atol=1e-3)


def test_half_turn_about_a_horizontal_axis():
    """(x, y, z) becomes (x, -y, -z): the map upside down and mirrored; the poles change places."""
    probe = torch.rand(2, 3, 12, 24)
    found = rotate_probes(probe, turn(180, (1, 0, 0)))
    expected = rotate_probes(probe, torch.eye(3)).flip(-2)
    torch.testing.assert_close(found, expected[..., half_turn_columns(24)], rtol=1e-3, atol=1e-4)
    assert bool((found[..., 0, :] == found[..., 0, :1]).all())


def half_turn_columns(width: int) -> Tensor:
    """-cos phi changes sign and sin phi does not: phi becomes pi - phi."""
    phi = torch.remainder(math.pi - 2 * math.pi * (torch.arange(width) + 0.5) / width, 2 * math.pi)
    return (phi * width / (2 * math.pi) - 0.5).round().long() % width


@pytest.mark.parametrize(("row", "column"), [(0, 3), (1, 17), (8, 0), (8, 31), (15, 9)])
def test_power_of_one_lamp(row: int, column: int):
    """At the poles, beside them, at the seam: the hardest probes there are."""
    probe = lamp(16, row, column)
    rotations = random_rotations(6)
    torch.testing.assert_close(power(rotate_probes(probe, rotations)), power(probe).expand(6, 3), rtol=1e-5, atol=0)


def test_a_lamp_goes_where_the_rotation_says():
    height = 32
    y, x = torch.meshgrid(torch.arange(height), torch.arange(2 * height), indexing="ij")
    directions = directions_at(x, y, height, 2 * height)
    weights = row_solid_angles(height, 2 * height)[:, None].float()

    def centre(radiance: Tensor) -> Tensor:
        moment = torch.einsum("...hw,hw,hwk->...k", radiance[..., 0, :, :] - 0.01, weights, directions)
        return torch.nn.functional.normalize(moment, dim=-1)

    rotations = random_rotations(8)
    for row, column in ((1, 5), (9, 63), (20, 30)):
        probe = lamp(height, row, column)
        expected = rotations @ directions[row, column]
        cosine = (centre(rotate_probes(probe, rotations)) * expected).sum(-1)
        assert float(cosine.min()) > math.cos(math.radians(4)), (row, column)


def test_power_of_real_probes(shared_data: Path):
    rotations = random_rotations(4)
    for name in PROBES:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # negative texels
            probe = LightProbe.open(shared_data / "probes" / name, height=64, rows="poles").radiance
        before = power(probe)
        kept = power(rotate_probes(probe, rotations)) / before - 1
        assert float(kept.abs().max()) < 1e-5, name
        unscaled = power(rotate_probes(probe, rotations, keep_power=False)) / before - 1
        assert float(unscaled.abs().max()) < (0.02 if name == "grace.hdr" else 4e-4), name


def test_gradients_of_radiance_and_rotation():
    radiance = torch.rand(2, 1, 4, 8, dtype=torch.float64, requires_grad=True)
    angles = torch.randn(2, 3, dtype=torch.float64, requires_grad=True)

    def turned(radiance: Tensor, angles: Tensor) -> Tensor:
        return rotate_probes(radiance, axis_angle_to_rotation_matrix(angles), supersampling=2)

    assert torch.autograd.gradcheck(turned, (radiance, angles), eps=1e-7, atol=1e-4)


def test_gradient_where_lookups_hit_the_poles():
    rotation = torch.eye(3, requires_grad=True)
    rotate_probes(torch.rand(3, 8, 16), rotation).square().sum().backward()
    assert bool(torch.isfinite(rotation.grad).all())
    assert bool((rotation.grad != 0).any())


def test_rotation_is_found_by_descent():
    """What differentiable is for: the turn of a probe, from five degrees off."""
    probe = LightProbe.default(24).radiance.log1p()
    truth = turn(5, (1, 2, -1)).float()
    target = rotate_probes(probe, truth, 3)
    angles = torch.zeros(1, 3, requires_grad=True)
    optimiser = torch.optim.LBFGS([angles], max_iter=25, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        value = (rotate_probes(probe, axis_angle_to_rotation_matrix(angles)[0], 3) - target).square().sum()
        value.backward()
        return value

    optimiser.step(loss)
    left = axis_angle_to_rotation_matrix(angles.detach())[0].T @ truth
    assert math.degrees(math.acos(min(1.0, (float(left.trace()) - 1) / 2))) < 0.1


def test_turned_probe_and_turned_directions_agree():
    """Resampling against looking up R^T d: the error is the texels' and falls with their size."""
    rotation = random_rotations(1)[0]
    directions = torch.nn.functional.normalize(torch.randn(4000, 3), dim=-1)
    errors = []
    for height in (32, 128):
        probe = LightProbe.default(height)
        turned = LightProbe(rotate_probes(probe.radiance, rotation))
        expected = probe.radiance_at(directions @ rotation)
        errors.append(float((turned.radiance_at(directions) - expected).abs().sum() / expected.sum()))
    assert errors[1] < 0.2
    assert errors[1] < 0.7 * errors[0]


def test_turned_light_of_basis_images_agrees():
    """`HarmonicBasis.basis_at(rotation)` looks up turned directions.

    Compared are its coefficients of the light as a matte ball sees them: few frequencies, means over many elevations.
    """
    probe, rotation = LightProbe.default(64), random_rotations(1)[0]

    def light(turning: TurningLight, rotation: Tensor | None) -> Tensor:
        coefficients = turning.harmonics(rotation)[0][0][:6]
        return torch.nn.functional.avg_pool1d(coefficients, coefficients.shape[-1] // 6)

    turned = TurningLight(LightProbe(rotate_probes(probe.radiance, rotation)))
    expected = light(TurningLight(probe), rotation)
    assert relative_rms(light(turned, None), expected) < 0.02
    assert relative_rms(light(TurningLight(probe), None), expected) > 0.1


def test_random_rotations():
    free = random_rotations(4000)
    torch.testing.assert_close(free @ free.mT, torch.eye(3).expand(4000, 3, 3), atol=1e-5, rtol=0)
    assert float(free.mean(0).abs().max()) < 0.05  # every orientation is equally likely
    about = random_rotations(100, (10, 20), (0, 2, 0))
    torch.testing.assert_close(about[:, :, 1], torch.tensor([0.0, 1, 0]).expand(100, 3), atol=1e-6, rtol=0)
    angle = torch.rad2deg(torch.acos((about.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2))
    assert 9.9 < float(angle.min()) < 12
    assert 18 < float(angle.max()) < 20.1
    some = random_rotations(200, (30, 30))
    torch.testing.assert_close(some.diagonal(dim1=1, dim2=2).sum(1), torch.full((200,), 1 + math.sqrt(3)))


def test_probe_augmentation_in_a_container():
    probes = torch.rand(3, 3, 8, 16)
    mask = torch.ones(3, 1, 8, 16, dtype=torch.bool)
    mask[:, :, 4, 5] = False
    pipeline = AugmentationSequential(RandomProbeRotation(), data_keys=["input", "mask"])
    turned, usable = pipeline(probes, mask)
    rotations = pipeline._params[0].data["rotation"]
    torch.testing.assert_close(turned, rotate_probes(probes, rotations))
    assert usable.dtype == torch.bool
    lost = rotate_probes((~mask).float(), rotations, keep_power=False) > 1e-4
    assert torch.equal(usable, ~lost)
    assert bool((~usable).flatten(1).any(1).all())
    again = pipeline(probes, mask, params=pipeline._params)
    assert torch.equal(again[0], turned)
    assert torch.equal(again[1], usable)


def test_probe_augmentation_settings():
    probes = torch.rand(1, 3, 8, 16).expand(4, -1, -1, -1)
    assert torch.equal(RandomProbeRotation(p=0)(probes), probes)
    same = RandomProbeRotation(same_on_batch=True)(probes)
    torch.testing.assert_close(same, same[:1].expand(4, -1, -1, -1))
    different = RandomProbeRotation(degrees=90, axis=(0, 1, 0))(probes)
    assert not torch.allclose(different[0], different[1])
    given = random_rotations(4).requires_grad_()
    RandomProbeRotation()(probes, params={"rotation": given}).sum().backward()
    assert given.grad is not None
    assert "degrees=(-5, 5)" in repr(RandomProbeRotation(5))
    assert RandomProbeRotation(keepdim=True)(probes[0]).shape == (3, 8, 16)


def test_half_precision_is_computed_in_single():
    probe, rotation = torch.rand(3, 8, 16), random_rotations(1)[0]
    found = rotate_probes(probe.half(), rotation)
    assert found.dtype == torch.float16
    torch.testing.assert_close(found, rotate_probes(probe.half().float(), rotation).half())


# --- masks ---


def test_erosion_against_distances():
    mask = torch.rand(2, 1, 20, 24) > 0.03
    places = torch.cartesian_prod(torch.arange(-4, 24), torch.arange(-4, 28)).float()
    for pixels in (0.0, 1.0, 1.5, 3.0):
        found = erode_silhouette(mask, pixels)
        for one, eroded in zip(mask, found, strict=True):
            padded = torch.nn.functional.pad(one[0], (4, 4, 4, 4))
            left_out = places[~padded.flatten()]
            distance = torch.cdist(places, left_out).amin(1).view(28, 32)[4:-4, 4:-4]
            assert torch.equal(eroded[0], one[0] & (distance > (pixels if pixels >= 1 else 0)))


def test_saturated_pixels():
    image = torch.full((2, 3, 9, 9), 0.5)
    image[0, 1, 4, 4] = 1.0
    image[1, 2, 0, 8] = math.nan
    found = mask_saturated(image, 1.0, margin=0)
    assert torch.nonzero(~found).tolist() == [[0, 0, 4, 4], [1, 0, 0, 8]]
    grown = mask_saturated(image, 1.0)
    assert int((~grown[0]).sum()) == 5
    assert int((~grown[1]).sum()) == 3  # a corner has two neighbours; the border hides nothing
    assert torch.equal(mask_saturated(image[0], 1.0), grown[0])


def test_stand_against_marched_rays():
    """Nine places of every pixel look along their mirrored rays; the stand is a cylinder cut by the ball."""
    radius, size = 0.3, 24
    view = SphereView(size)
    found = mask_stand(view, radius, margin=0)
    edges = torch.linspace(-1, 1, 2 * size + 1, dtype=torch.float64)
    t = torch.logspace(-4, 3, 6000, dtype=torch.float64)
    expected = view.mask.clone()
    for row, column in torch.nonzero(view.mask[0]).tolist():
        x, y = torch.meshgrid(edges[2 * column : 2 * column + 3], -edges[2 * row : 2 * row + 3], indexing="xy")
        point = torch.stack([x, y, (1 - x * x - y * y).clamp_min(0).sqrt()]).flatten(1)
        ray = 2 * point[2] * point - torch.tensor([[0.0], [0], [1]], dtype=torch.float64)
        a, b, c = (point[..., None] + torch.cat([torch.zeros(1), t]) * ray[..., None]).unbind(0)
        expected[0, row, column] = not bool(((a * a + c * c < radius**2) & (b < 0)).any())
    assert int((found != expected).sum()) <= 1  # rays that graze the edge
    assert torch.equal(found, found.flip(-1))
    assert 10 < int((view.mask & ~found).sum()) < 80
    assert not bool(found[0, 22, 11])  # the bottom
    assert bool(found[0, :11].equal(view.mask[0, :11]))  # the upper half shows no stand


def test_stands_of_a_batch():
    found = mask_stand(VIEW, torch.tensor([0.0, 0.1, 0.3, 0.6]), margin=0)
    assert found.shape == (4, 1, SIZE, SIZE)
    left = found.flatten(1).sum(1)
    assert left.tolist() == sorted(left.tolist(), reverse=True)
    assert torch.equal(found[0], VIEW.mask)
    torch.testing.assert_close(mask_stand(VIEW, 0.3, margin=0), found[2])
    assert int(mask_stand(VIEW, 0.3).sum()) < int(left[2])


def test_reflection_of_the_camera():
    """The mirrored cone of half angle a is the disc of radius sin(a / 2) about the centre; all pixels it touches go."""
    view = SphereView(64)
    x, y = pixel_grid(64, 64).abs()
    found = mask_reflection(view, torch.tensor([0.0, 2, 20, 60]), margin=0)
    for angle, mask in zip((0, 2, 20, 60), found, strict=True):
        nearest = torch.hypot(x - 1 / 64, y - 1 / 64)  # the pixels' inner corners
        disc = nearest < math.sin(math.radians(angle / 2)) - 1e-6
        assert torch.equal(mask[0], view.mask[0] & ~disc)


def test_reflection_of_a_lamp():
    """A lamp at image right is mirrored where the normal is half-way to it."""
    view = SphereView(65)
    hidden = view.mask & ~mask_reflection(view, 10.0, (1, 0, 0), margin=0)
    x, y = pixel_grid(65, 65)
    assert float(x[hidden[0]].mean()) == pytest.approx(math.sqrt(0.5), abs=0.02)
    assert float(y[hidden[0]].mean()) == pytest.approx(0, abs=1e-6)


def shapes(**changed: Tensor) -> dict[str, Tensor]:
    given = {
        "kind": torch.tensor([0]),
        "centre": torch.zeros(1, 2),
        "size": torch.tensor([0.5]),
        "angle": torch.tensor([0.0]),
        "corners": torch.full((1, 9), 0.5),
    }
    return {**given, **changed}


def test_area_and_place_of_an_ellipse():
    grid = pixel_grid(200, 200)
    centre = torch.tensor([[0.2, -0.3]])
    found = draw_occluders(**shapes(centre=centre, angle=torch.tensor([math.pi / 3])), grid=grid)[0]
    assert 4 * float(found.float().mean()) == pytest.approx(math.pi * 0.5 * 0.25, rel=0.02)
    inside = grid[:, found]
    torch.testing.assert_close(inside.mean(1), centre[0], atol=2e-3, rtol=0)
    long_axis = torch.linalg.eigh(torch.cov(inside)).eigenvectors[:, 1]
    assert abs(float(long_axis @ torch.tensor([0.5, math.sqrt(3) / 2]))) == pytest.approx(1, abs=1e-4)


def test_area_of_a_polygon():
    corners = 0.35 + 0.65 * torch.rand(1, 9)
    found = draw_occluders(
        **shapes(kind=torch.tensor([1]), corners=corners, size=torch.tensor([0.9])), grid=pixel_grid(300, 300)
    )[0]
    radii = 0.9 * corners[0]
    expected = 0.5 * math.sin(2 * math.pi / 9) * float((radii * radii.roll(1)).sum())
    assert 4 * float(found.float().mean()) == pytest.approx(expected, rel=0.01)


def test_a_hand_reaches_in_from_outside():
    size = torch.tensor([0.2])
    found = draw_occluders(**shapes(kind=torch.tensor([2]), size=size), grid=pixel_grid(101, 101))[0]
    assert bool(found[50, 0])
    assert bool(found[50, 50])
    assert not bool(found[:, -1].any())
    fingers = found[:, 63].int().diff().clamp_min(0).sum()  # crossings of a line across the fingers, thumb apart
    assert int(fingers) == 4
    turned = draw_occluders(
        **shapes(kind=torch.tensor([2]), size=size, angle=torch.tensor([math.pi / 2])), grid=pixel_grid(101, 101)
    )[0]
    assert torch.equal(turned, found.rot90())


def test_pixel_grid():
    x, y = pixel_grid(2, 4)
    assert x[0].tolist() == [-0.75, -0.25, 0.25, 0.75]
    assert y[:, 0].tolist() == [0.25, -0.25]


HIDING = {
    "erosion": lambda **options: RandomSilhouetteErosion(VIEW, (1, 3), **options),
    "saturation": lambda **options: RandomSaturation((0.05, 0.2), **options),
    "stand": lambda **options: RandomStand(VIEW, (0.3, 0.5), **options),
    "reflection": lambda **options: RandomReflection(VIEW, (15, 30), **options),
    "occluders": lambda **options: RandomOccluders((2, 3), (0.3, 0.6), **options),
    "dropout": lambda **options: RandomDropout((0.2, 0.4), **options),
    "patches": lambda **options: RandomDropout((0.3, 0.4), patch=5, **options),
}


def photographs(count: int = 4) -> tuple[Tensor, Tensor]:
    return torch.where(VIEW.mask, 0.2 + torch.rand(count, 3, SIZE, SIZE), 0), VIEW.mask.expand(count, -1, -1, -1)


@pytest.mark.parametrize("name", HIDING)
def test_images_and_masks_lose_the_same_pixels(name: str):
    images, masks = photographs()
    pipeline = AugmentationSequential(HIDING[name](p=1.0, known=True), data_keys=["input", "mask"])
    found, usable = pipeline(images, masks)
    changed = (found != images).any(1, keepdim=True)
    assert usable.dtype == torch.bool
    assert bool(changed.flatten(1).any(1).all())
    assert not bool((changed & usable).any())
    assert bool((usable <= masks).all())
    share = 1 - usable.sum() / masks.sum()
    assert 0.01 < float(share) < 0.8
    replayed = pipeline(images, masks, params=pipeline._params)
    assert torch.equal(replayed[0], found)
    assert torch.equal(replayed[1], usable)
    other = pipeline(images, masks)
    assert not torch.equal(other[1], usable)


@pytest.mark.parametrize("name", HIDING)
def test_what_is_not_known_stays_in_masks(name: str):
    images, masks = photographs()
    pipeline = AugmentationSequential(HIDING[name](p=1.0, known=False), data_keys=["input", "mask"])
    found, usable = pipeline(images, masks)
    assert torch.equal(usable, masks)
    assert not torch.equal(found, images)


@pytest.mark.parametrize("name", HIDING)
def test_settings_of_the_base_class(name: str):
    images, masks = photographs(1)
    images, masks = images.expand(64, -1, -1, -1), masks.expand(64, -1, -1, -1)
    skipped = AugmentationSequential(HIDING[name](p=0.0, known=True), data_keys=["input", "mask"])(images, masks)
    assert torch.equal(skipped[0], images)
    assert torch.equal(skipped[1], masks)
    half, usable = AugmentationSequential(HIDING[name](p=0.5, known=True), data_keys=["input", "mask"])(images, masks)
    touched = (half != images).flatten(1).any(1)
    assert 16 < int(touched.sum()) < 48
    assert torch.equal(touched, (usable != masks).flatten(1).any(1))
    same = HIDING[name](p=1.0, same_on_batch=True)(images[:5])
    assert torch.equal(same, same[:1].expand(5, -1, -1, -1))
    assert name == "reflection" or "known=" in repr(HIDING[name]())


@pytest.mark.parametrize("name", HIDING)
def test_gradients_flow_to_what_stays(name: str):
    images, _ = photographs()
    images.requires_grad_()
    augmentation = HIDING[name](p=1.0)
    found = augmentation(images)
    found.sum().backward()
    untouched = (found == images).all(1, keepdim=True) & (images > 0).all(1, keepdim=True)
    assert bool(torch.isfinite(images.grad).all())
    if name not in ("stand", "occluders"):  # their colour depends on the mean of the image
        assert bool((images.grad[untouched.expand_as(images)] == 1).all())


def test_distances_of_erosion():
    found = RandomSilhouetteErosion(VIEW, (1, 3), p=1.0)(torch.ones(60, 3, SIZE, SIZE))
    expected = {int(erode_silhouette(VIEW.mask, k).sum()) for k in (1, 2, 3)}
    assert set(found[:, 0].flatten(1).sum(1).long().tolist()) == expected


def test_saturation_clips_at_a_level():
    images, masks = photographs()
    augmentation = RandomSaturation((0.1, 0.1), margin=0, p=1.0)
    found, usable = AugmentationSequential(augmentation, data_keys=["input", "mask"])(images, masks)
    level = found.amax((1, 2, 3), keepdim=True)
    torch.testing.assert_close(found, torch.minimum(images, level))
    assert torch.equal(~usable & masks, (images > level).any(1, keepdim=True))
    assert (1 - usable.flatten(1).sum(1) / masks.flatten(1).sum(1)).tolist() == pytest.approx([0.1] * 4, abs=0.002)
    unclipped = RandomSaturation((0.0, 0.0), p=1.0)(images)
    assert torch.equal(unclipped, images)


def test_share_of_dropped_patches():
    kept = RandomDropout((0.3, 0.3), patch=4, p=1.0)(torch.ones(50, 3, 62, 62))
    assert float(1 - kept.mean()) == pytest.approx(0.3, abs=0.01)
    block = kept[:, :, :60, :60].unflatten(-1, (15, 4)).unflatten(-3, (15, 4))
    assert bool((block.amax((-3, -1)) == block.amin((-3, -1))).all())


# --- sensors ---


def test_exposure_is_a_factor():
    images, _ = photographs()
    found = RandomExposure((-1.0, 1.0))(images)
    gain = (found / images)[..., SIZE // 2, SIZE // 2]
    torch.testing.assert_close(found, images * gain[..., None, None])
    torch.testing.assert_close(gain, gain[:, :1].expand(4, 3))
    assert 0.5 <= float(gain.min()) < float(gain.max()) <= 2
    tinted = RandomExposure((1.0, 1.0), colour=0.2)(images)
    gain = (tinted / images)[..., SIZE // 2, SIZE // 2]
    assert float(gain.std(1).min()) > 0
    assert 2**0.8 <= float(gain.min()) < float(gain.max()) <= 2**1.2


def test_flicker_bands():
    found = flicker(100, torch.tensor([0.2]), torch.tensor([2.0]), torch.tensor([0.7]))[0, 0, :, 0]
    expected = 1 + 0.2 * torch.sin(4 * math.pi * (torch.arange(100) + 0.5) / 100 + 0.7)
    torch.testing.assert_close(found, expected)
    images = torch.rand(3, 3, 20, 30)
    gain = RandomFlicker(p=1.0)(images) / images
    torch.testing.assert_close(gain, gain[:, :1, :, :1].expand_as(gain))
    assert float(gain.std(2).min()) > 0


def test_noise_that_reaches_farther_than_the_image():
    with pytest.raises(ValueError, match=r"^blur 5 reaches 15 pixels far, farther than images of 8 x 40; give less$"):
        RandomSensorNoise(blur=5.0)(torch.ones(1, 3, 8, 40))


@pytest.mark.parametrize("blur", [0.0, 1.0])
def test_size_of_noise(blur: float):
    image = torch.full((1, 3, 200, 200), 2.0)
    image[..., 100:] = 8.0  # the mean is 5
    noise = sensor_noise(image, torch.randn_like(image), 0.1, 0.02, blur)
    for half, radiance in zip(noise.split(100, -1), (2.0, 8.0), strict=True):
        expected = math.sqrt(0.1**2 * radiance * 5 + (0.02 * 5) ** 2)
        assert float(half.std()) == pytest.approx(expected, rel=0.03 if blur == 0 else 0.08)
    neighbours = (noise[..., 1:] * noise[..., :-1]).mean() / noise.square().mean()
    assert float(neighbours) == pytest.approx(math.exp(-1 / 4) if blur else 0, abs=0.02)


def test_noise_is_replayed():
    images, _ = photographs()
    augmentation = RandomSensorNoise((0.1, 0.1), blur=0.7)
    found = augmentation(images)
    assert torch.equal(augmentation(images, params=augmentation._params), found)
    assert not torch.equal(augmentation(images), found)
    same = RandomSensorNoise(same_on_batch=True)(images[:1].expand(3, -1, -1, -1))
    assert torch.equal(same[0], same[2])


def test_a_whole_pipeline():
    images, masks = photographs(8)
    pipeline = photograph_defects(VIEW, known=True)
    found, usable = pipeline(images, masks)
    assert found.shape == images.shape
    assert usable.dtype == torch.bool
    assert bool((usable <= masks).all())
    assert not torch.equal(usable, masks)
    shuffled = AugmentationSequential(*pipeline.children(), data_keys=["input", "mask"], random_apply=(2, 4))
    found, usable = shuffled(images, masks)
    again = shuffled(images, masks, params=shuffled._params)
    assert torch.equal(again[0], found)
    assert torch.equal(again[1], usable)
    torch.manual_seed(5)
    first = pipeline(images, masks)[0]
    torch.manual_seed(5)
    assert torch.equal(pipeline(images, masks)[0], first)


BAD = {
    r"light probes must be lat-long \(\*batch, C, H, 2 H\), got \(3, 8, 8\)": lambda: rotate_probes(
        torch.rand(3, 8, 8), torch.eye(3)
    ),
    r"rotation must be \(\*batch, 3, 3\), got \(2, 3\)": lambda: rotate_probes(torch.rand(3, 8, 16), torch.rand(2, 3)),
    "rotation must be orthonormal with determinant": lambda: rotate_probes(torch.rand(3, 8, 16), -torch.eye(3)),
    "light probes must hold linear floating-point radiance, got torch.uint8": lambda: rotate_probes(
        torch.zeros(3, 8, 16, dtype=torch.uint8), torch.eye(3)
    ),
    "supersampling must be at least 1, got 0": lambda: rotate_probes(torch.rand(3, 8, 16), torch.eye(3), 0),
    r"degrees must be an angle or a range \(low, high\) of them, got \(5, 1\)": lambda: RandomProbeRotation((5, 1)),
    r"axis must be three finite numbers, not all zero, got \(0, 0, 0\)": lambda: RandomProbeRotation(5, (0, 0, 0)),
    r"mask must be \(\*batch, 1, H, W\) bool, got torch.float32": lambda: erode_silhouette(torch.ones(1, 4, 4), 1),
    "pixels must be a distance of at least 0, got -1": lambda: erode_silhouette(VIEW.mask, -1),
    r"radius of the stand must lie in \[0, 1\) radii of the ball, got 1.5": lambda: mask_stand(VIEW, 1.5),
    "mask_stand knows the stand of a SphereView only, got str": lambda: mask_stand("ball", 0.1),
    "half_angle_deg must lie between 0 and 180 degrees, got 200": lambda: mask_reflection(VIEW, 200),
    r"direction must be three numbers, not all zero, got \(0, 0, 0\)": lambda: mask_reflection(VIEW, 5, (0, 0, 0)),
    r"share must be a range \(least, largest\) within \[0, 1\], got \(0.5, 0.1\)": lambda: RandomDropout((0.5, 0.1)),
    "patch must be at least one pixel, got 0": lambda: RandomDropout(patch=0),
    "kinds must be some of ellipse, polygon, hand, got": lambda: RandomOccluders(kinds=("cube",)),
    r"stops must be a range \(least, largest\) within": lambda: RandomExposure((-float("inf"), 0)),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_input(message: str):
    with pytest.raises(ValueError, match=message):
        BAD[message]()


def test_what_random_rotations_take():
    angles = random_rotations(50, degrees=5).diagonal(dim1=1, dim2=2).sum(1).sub(1).div(2).clamp(-1, 1).acos()
    assert 0 < float(angles.max()) < 0.0874
    for axis in ((0, 0, 0), (0, math.nan, 1), (1, 0)):
        with pytest.raises(ValueError, match=r"^axis must be three finite numbers, not all zero, got "):
            random_rotations(1, axis=axis)
    for degrees in ((0, math.nan), (2, 1), math.inf):
        with pytest.raises(ValueError, match=r"^degrees must be an angle or a range"):
            random_rotations(1, degrees=degrees)
