"""The radiance of clipped lamps: photographs of strangers by the sampled transport, under a room with a bright lamp."""

from math import inf, log

import pytest
import torch
from torch import Tensor

from probes import relative
from torchbrdf.alignment.alignment import Alignment, align
from torchbrdf.alignment.lamps import LampRadiance
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.lamps import Lamps
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.tables import render_tables
from torchbrdf.view.sphere import SphereView
from turns import turn_about

VIEW = SphereView(32)
LEVEL = 3000.0
FACTORS = torch.tensor([50.0, 45.0, 36.0], dtype=torch.float64)
"""By which the lamp is clipped."""


def room(place: tuple[slice, slice], level: float = LEVEL) -> Tensor:
    """(3, 64, 128): the default probe with a lamp of some texels that is clipped."""
    radiance = LightProbe.default(64).radiance.clone()
    radiance[:, place[0], place[1]] = level
    return radiance


FRONT = slice(20, 22), slice(75, 77)
BEHIND = slice(30, 32), slice(0, 2)


@pytest.fixture(scope="module")
def paint(strangers: dict[str, MerlTable]) -> Tensor:
    """(3, 32, 32) under the true light of the lamp in front."""
    true = LightProbe(room(FRONT)).relit(FACTORS)
    return render_tables([strangers["paint"]], true, VIEW, samples=1024, seed=1)[0]


@pytest.fixture(scope="module")
def found(paint: Tensor, precomputed_library: MaterialLibrary) -> Alignment:
    return align(paint, LightProbe(room(FRONT)), VIEW, precomputed_library)


def test_clipped_lamp_is_found(found: Alignment) -> None:
    assert found.lamp is not None
    assert found.lamp.clipped
    assert found.lamp.confident
    torch.testing.assert_close(found.lamp.factors, FACTORS, rtol=0.15, atol=0)


def test_posterior_holds_the_truth(found: Alignment) -> None:
    assert bool(((found.lamp.factors / FACTORS).log().abs() < 3 * found.lamp.std).all())


def test_its_light_is_in_the_probe(found: Alignment) -> None:
    assert found.source.lamps is None
    ratio = found.source.radiance[:, 20, 75] / LEVEL
    torch.testing.assert_close(ratio, found.lamp.factors.float())
    assert torch.equal(found.source.radiance[:, 30:], LightProbe(room(FRONT)).radiance[:, 30:])


def test_said_in_words(found: Alignment) -> None:
    text = str(found)
    assert "\n" not in text
    where = "rows 20 to 21, columns 75 to 76, counted from 0"
    assert f"its lamp of 4 texels of radiance 3000 ({where}) brightened, in R" in text


def test_under_a_turned_probe(paint: Tensor, precomputed_library: MaterialLibrary) -> None:
    """The first guess, under the rotation that is believed, is far off here."""
    turn = turn_about((1, -2, 1.5), 2)
    found = align(paint, LightProbe(room(FRONT)).rotated(turn.T), VIEW, precomputed_library)
    torch.testing.assert_close(found.lamp.factors, FACTORS, rtol=0.35, atol=0)


def test_infinite_texels(paint: Tensor, precomputed_library: MaterialLibrary) -> None:
    """Their radiance is that of the lamp, whatever the search began with."""
    probe = LightProbe(room(FRONT, inf), unknown_lamps=True)
    found = align(paint, probe, VIEW, precomputed_library)
    assert found.lamp.log_odds == inf
    radiance = found.source.radiance[:, 20, 75].double()
    torch.testing.assert_close(radiance, LEVEL * FACTORS, rtol=0.15, atol=0)


def test_lamp_that_was_not_clipped(
    photographs: dict[str, Tensor], precomputed_library: MaterialLibrary
) -> None:
    """A plateau that is there: the spotlight of the default probe, as an array of others has it."""
    probe = LightProbe(LightProbe.default(64).radiance)
    assert probe.lamps is not None
    found = align(photographs["paint"], probe, SphereView(48), precomputed_library)
    assert not found.lamp.clipped
    assert found.lamp.factors.tolist() == [1, 1, 1]
    assert torch.equal(found.source.radiance, probe.radiance)


def test_lamp_that_lights_nothing(strangers: dict[str, MerlTable], precomputed_library: MaterialLibrary) -> None:
    """Right behind the ball only its rim would show it: left as it is, and said to be uncertain."""
    probe = LightProbe(room(BEHIND))
    image = render_tables([strangers["clay"]], probe.relit(FACTORS), VIEW, samples=512, seed=2)[0]
    dark = render_tables([strangers["clay"]], probe.relit(torch.zeros(3)), VIEW, samples=512, seed=2)[0]
    assert relative(image, dark) < 0.02
    found = align(image, probe, VIEW, precomputed_library)
    assert not found.lamp.clipped
    assert torch.equal(found.source.radiance, probe.radiance)


def test_without_lamps(photographs: dict[str, Tensor], precomputed_library: MaterialLibrary) -> None:
    assert align(photographs["satin"], LightProbe.default(64), SphereView(48), precomputed_library).lamp is None


@pytest.mark.parametrize(
    ("odds", "std", "text"),
    [
        (log(100), 0.05, "its lamp of 2 texels brightened, in R, G, B by 2 +- 5 %, 2 +- 5 %, 2 +- 5 %"),
        (log(2), 0.05, "its lamp of 2 texels left as it is"),
        (log(2), 2.0, "its lamp of 2 texels left as it is, which this photograph cannot tell for sure"),
    ],
)
def test_clauses(odds: float, std: float, text: str) -> None:
    lamps = Lamps(torch.ones(3, 8, 16), "2 texels", unknown=False, certain=True)
    factors = torch.full((3,), 2.0 if odds > log(10) else 1.0, dtype=torch.float64)
    assert str(LampRadiance(lamps, factors, torch.full((3,), std, dtype=torch.float64), odds)) == text
