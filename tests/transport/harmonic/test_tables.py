"""Pictures of single tables by the harmonic transport: closed forms, the sampled transport as an oracle, refusals."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from materials import TINY_MATERIALS, lambert
from probes import lamps, relative
from torchbrdf.brdf.directions import half_difference
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.tables import render, render_tables
from torchbrdf.transport.harmonic._seen_tables import SeenTable
from torchbrdf.transport.harmonic._table_kernels import EXACT, SHOWN, reflections
from torchbrdf.transport.harmonic.tables import table_pictures
from torchbrdf.view.sphere import SphereView
from torchbrdf.view.view import View
from turns import turn_about

SPHERE = SphereView(16)
ALBEDO = (0.8, 0.5, 0.2)

MOST = 5e-3
"""Relative error; the sampled transport's own is 0.1 to 0.3 %."""


def swirl(w_i: Tensor, w_o: Tensor) -> Tensor:
    """f_r that tells phi_d from -phi_d."""
    _, theta_d, phi_d = half_difference(w_i, w_o)
    wave = 1 + 0.9 * torch.sin(2 * phi_d) * torch.sin(2 * theta_d)
    return (wave / math.pi)[..., None].expand(*wave.shape, 3)


def table_of(f_r: Callable[[Tensor, Tensor], Tensor]) -> MerlTable:
    return MerlTable.from_function(f_r, "table")


def differs(f_r: Callable[[Tensor, Tensor], Tensor], view: View, probe: LightProbe) -> float:
    table = table_of(f_r)
    return relative(render(table, probe, view), render_tables([table], probe, view, samples=16384)[0])


def test_uniform_light_shows_the_albedo() -> None:
    picture = render(table_of(lambert(*ALBEDO)), LightProbe(torch.ones(3, 32, 64)), SPHERE)
    expected = torch.tensor(ALBEDO)[:, None, None] * SPHERE.mask
    assert relative(picture, expected) < 1e-3


def test_what_is_written_into_a_table_is_seen() -> None:
    table, probe = table_of(lambert(*ALBEDO)), LightProbe(torch.ones(3, 32, 64))
    before = render(table, probe, SPHERE)
    table.values.mul_(2)
    assert relative(render(table, probe, SPHERE), 2 * before) < 1e-6


@pytest.mark.parametrize("f_r", [swirl, TINY_MATERIALS["copper-0.08"]], ids=["asymmetric", "close to a mirror"])
def test_agrees_with_samples(f_r: Callable[[Tensor, Tensor], Tensor]) -> None:
    assert differs(f_r, SPHERE, lamps(64)) < MOST


@pytest.mark.parametrize(
    "view",
    [SphereView(16, fov_deg=15.0), SphereView(16, fov_deg=8.0, direction=(0.3, -0.2, -1.0))],
    ids=repr,
)
def test_balls_in_perspective_agree_with_samples(view: SphereView) -> None:
    assert differs(TINY_MATERIALS["satin-0.35"], view, lamps(64)) < MOST


def test_the_shadow_line_of_a_lamp_is_converged() -> None:
    """Where light grazes a material that is bright at grazing angles, its image ends in a step."""
    radiance = torch.full((3, 128, 256), 1e-4)
    radiance[:, 50, 100] = 1000
    table = table_of(lambda w_i, w_o: (0.05 / (w_i[..., 2] * w_o[..., 2] + 0.02))[..., None].expand(*w_i.shape[:-1], 3))
    finer = replace(EXACT, azimuths=tuple(2 * each for each in EXACT.azimuths))
    picture, converged = (
        table_pictures(table, [(LightProbe(radiance), None)], SphereView(64), detail)[0] for detail in (EXACT, finer)
    )
    assert relative(picture, converged) < 3e-3


def test_each_light_is_turned_by_its_own_rotation() -> None:
    table, turn = table_of(TINY_MATERIALS["satin-0.35"]), turn_about((0.3, 1.0, 0.2), 70.0)
    probe = lamps(64)
    upright, turned = table_pictures(table, [(probe, None), (probe, turn)], SPHERE)
    assert relative(upright, render(table, probe, SPHERE)) < 1e-5
    assert relative(turned, render(table, probe.rotated(turn), SPHERE)) < 2e-2  # whose texels are resampled


def test_a_table_that_is_shown_again_looks_the_same() -> None:
    """Its kernels are kept from the second picture on, with all frequencies; other lights want fewer or more."""
    table, lights = table_of(swirl), [lamps(64), LightProbe(torch.ones(3, 32, 64)), lamps(64)]
    once = [render(table_of(swirl), light, SPHERE) for light in lights]
    again = [render(table, light, SPHERE) for light in lights]
    assert max(relative(mine, other) for mine, other in zip(again, once, strict=True)) < 1e-5


def test_half_vectors_are_read_as_they_were_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those for pictures that are only looked at are kept, of an orthographic camera."""
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path))
    lights = [(lamps(32), None)]
    pictures = []
    for _ in range(2):
        reflections.cache_clear()
        pictures.append(table_pictures(table_of(swirl), lights, SPHERE, SHOWN))
    zones = len(SHOWN.zones) - SeenTable.of(table_of(swirl)).merged
    assert torch.equal(*pictures)
    assert len(list((tmp_path / "reflections").iterdir())) == zones
    assert relative(pictures[0][0], render(table_of(swirl), lights[0][0], SPHERE)) < 1e-2
    table_pictures(table_of(swirl), lights, SphereView(16, fov_deg=15.0), SHOWN)
    assert len(list((tmp_path / "reflections").iterdir())) == zones


def test_a_table_without_lobes_needs_no_zones_for_them() -> None:
    table = table_of(TINY_MATERIALS["satin-0.35"])
    seen = SeenTable.of(table)
    assert seen.merged > 0
    merged = render(table, lamps(64), SPHERE)
    seen.merged = 0
    assert relative(merged, render(table, lamps(64), SPHERE)) < 3e-3


def test_kernels_of_a_table_are_let_go_of_for_another() -> None:
    tables = [table_of(lambert(*ALBEDO)) for _ in range(2)]
    for table in (tables[0], tables[0], tables[1]):
        render(table, lamps(32), SPHERE)
    assert [SeenTable.of(table).kept for table in tables] == [False, False]


def test_gradients_reach_the_light() -> None:
    """A picture is linear in the radiance, so its sum is the gradient's product with it."""
    radiance = lamps(32).radiance.requires_grad_()
    total = render(table_of(lambert(*ALBEDO)), LightProbe(radiance), SPHERE).sum()
    total.backward()
    assert float((radiance.grad * radiance.detach()).sum()) == pytest.approx(float(total.detach()), rel=1e-4)


def test_no_radiance_is_negative_about_a_lamp_in_the_dark() -> None:
    radiance = torch.zeros(3, 64, 128)
    radiance[:, 20, 40] = 1e4
    table = table_of(TINY_MATERIALS["copper-0.08"])
    picture = render(table, LightProbe(radiance), SPHERE)
    assert float(picture.min()) == 0.0 < float(picture.max())


def test_a_number_of_samples_asks_for_sampling() -> None:
    table, probe = table_of(lambert(*ALBEDO)), lamps(32)
    expected = render_tables([table], probe, SPHERE, samples=64, seed=3)[0]
    assert torch.equal(render(table, probe, SPHERE, samples=64, seed=3), expected)


def test_a_near_ball_is_sampled() -> None:
    table, probe, near = table_of(lambert(*ALBEDO)), LightProbe(torch.ones(3, 8, 16)), SphereView(16, fov_deg=60.0)
    with pytest.raises(ValueError, match="nearer than 6"):
        table_pictures(table, [(probe, None)], near)
    assert float(render(table, probe, near)[0][near.mask[0]].mean()) == pytest.approx(ALBEDO[0], rel=0.02)
