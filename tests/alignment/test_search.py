"""The evidence of rotations: its top, its slopes and curvature against differences, climbs, priors, blurred light."""

from math import degrees, log, radians
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from torchbrdf.alignment import _search as rotation_search
from torchbrdf.alignment._promise import likeliest
from torchbrdf.alignment._search import RotationSearch, Summit, Trial, best_of
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.light.probe import LightProbe
from torchbrdf.light.rotations import rotation_vector
from torchbrdf.transport.harmonic.basis import HarmonicBasis
from torchbrdf.view.sphere import SphereView
from turns import degrees_between, turn_about

AXES = torch.eye(3, dtype=torch.float64)
VIEW = SphereView(48)
ALL = torch.ones(len(VIEW.pixels), dtype=torch.bool)
EXPECTED = radians(5)


@pytest.fixture(scope="module")
def room(quarter_library: MaterialLibrary) -> HarmonicBasis:
    return HarmonicBasis(quarter_library, LightProbe.default(64), VIEW)


@pytest.fixture(scope="module")
def searches(room: HarmonicBasis, photographs: dict[str, Tensor]) -> dict[str, RotationSearch]:
    """One for each photograph, whose frame is that of no turn, the right one."""
    found = {name: search(room, image) for name, image in photographs.items()}
    for one in found.values():
        one.trial(AXES)
    return found


def search(light: HarmonicBasis, image: Tensor, expected: float = EXPECTED) -> RotationSearch:
    return RotationSearch(light, VIEW.pack(image)[None].double(), ALL, expected)


def turned(axis: Tensor, angle: float) -> Tensor:
    """By degrees."""
    return turn_about(axis.tolist(), angle)


@pytest.mark.parametrize("material", ["paint", "clay"])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0.5, -0.7, 0.5)])
def test_falls_off_steadily(searches: dict[str, RotationSearch], material: str, axis: tuple[float, ...]) -> None:
    """For many degrees to both sides of the truth, for a glossy and for a matte material."""
    one = searches[material]
    for sign in (1, -1):
        heights = [one.trial(turn_about(axis, sign * angle)).log_evidence for angle in (0, 0.5, 1, 2, 4, 8)]
        assert heights == sorted(heights, reverse=True)
        assert heights[0] > heights[-1] + 50


def test_a_trial_is_solved_under_the_turned_light(room: HarmonicBasis, photographs: dict[str, Tensor]) -> None:
    """Its basis is that of the rotation, and the weights of its best priors explain the photograph."""
    one, rotation = search(room, photographs["satin"]), turned(AXES[1], -3)
    trial = one.trial(rotation)
    assert torch.equal(trial.rotation, rotation)
    assert torch.equal(trial.basis.packed, room.basis_at(rotation).packed)
    right = one.trial(AXES)
    packed, y = right.basis.packed.double(), one.y[0]
    error = torch.einsum("cn,ncp->cp", right.explanation.mean[0], packed) - y
    assert float(error.norm() / y.norm()) < 0.02
    assert one.evaluations == 2


def test_pixels_not_used_do_not_count(room: HarmonicBasis, photographs: dict[str, Tensor]) -> None:
    used = ALL.clone()
    used[::3] = False
    y = VIEW.pack(photographs["paint"])[None].double()
    evidence = [
        RotationSearch(room, values[..., used], used, EXPECTED).trial(turned(AXES[0], 2)).log_evidence
        for values in (y, torch.where(ALL & used, y, 1e3))
    ]
    assert evidence[0] == evidence[1]
    whole = RotationSearch(room, y, ALL, EXPECTED).trial(turned(AXES[0], 2)).log_evidence
    assert whole != evidence[0]
    right = RotationSearch(room, y[..., used], used, EXPECTED).trial(AXES)
    image = torch.einsum("cn,ncp->cp", right.explanation.mean[0], right.basis.packed.double())
    assert float((image - y[0])[:, used].norm() / y[0, :, used].norm()) < 0.02


@pytest.mark.parametrize("material", ["paint", "brass", "satin", "clay"])
def test_slope(searches: dict[str, RotationSearch], material: str) -> None:
    """Two degrees off, against differences; it points home."""
    one, away = searches[material], turned(torch.tensor([2.0, -1.0, 1.5]), 2.5)
    gradient, _ = one._slope(one.trial(away))
    step = radians(0.15)
    differences = [
        one.trial(turned(axis, 0.15) @ away).log_evidence - one.trial(turned(axis, -0.15) @ away).log_evidence
        for axis in AXES
    ]
    expected = torch.tensor(differences, dtype=torch.float64) / (2 * step)
    assert float((gradient - expected).norm()) < 0.03 * float(expected.norm())
    assert float(gradient @ torch.tensor([2.0, -1.0, 1.5]).double()) < 0


@pytest.mark.parametrize(("material", "tolerance"), [("clay", 0.15), ("paint", 0.3)])
def test_curvature_at_the_top(searches: dict[str, RotationSearch], material: str, tolerance: float) -> None:
    """The whole matrix against second differences, in units of its diagonal."""
    one, step = searches[material], radians(0.12)
    top = one.climb(one.trial(AXES))

    def height(vector: Tensor) -> float:
        angle = float(vector.norm())
        rotation = turned(vector, degrees(step) * angle) if angle else AXES
        return one.trial(rotation @ top.trial.rotation).log_evidence

    at_top = height(torch.zeros(3))
    expected = torch.zeros(3, 3, dtype=torch.float64)
    for a in range(3):
        expected[a, a] = -(height(AXES[a]) - 2 * at_top + height(-AXES[a])) / step**2
        for b in range(a):
            corners = [s * t * height(s * AXES[a] + t * AXES[b]) for s in (1, -1) for t in (1, -1)]
            expected[a, b] = expected[b, a] = -sum(corners) / (4 * step**2)
    expected += AXES / EXPECTED**2
    unit = expected.diagonal().sqrt()
    difference = (top.precision - expected) / (unit[:, None] * unit)
    assert float(difference.abs().max()) < tolerance
    torch.testing.assert_close(top.precision, top.precision.T)
    assert float(torch.linalg.eigvalsh(top.precision)[0]) > 1 / EXPECTED**2


@pytest.mark.parametrize("degrees_away", [1.0, 15.0])
def test_climbs_to_the_truth(searches: dict[str, RotationSearch], degrees_away: float) -> None:
    one = searches["paint"]
    start = one.trial(turned(torch.tensor([1.0, 2.0, -1.0]), degrees_away))
    before = one.evaluations
    summit = one.climb(start)
    assert degrees_between(summit.trial.rotation, AXES) < 0.15
    assert summit.converged
    assert summit.trial.log_evidence > start.log_evidence
    assert 1 <= one.evaluations - before < 10


def test_starting_at_the_top(searches: dict[str, RotationSearch]) -> None:
    one = searches["brass"]
    summit = one.climb(one.trial(AXES))
    again = one.climb(summit.trial)
    assert again.trial.log_evidence >= summit.trial.log_evidence >= one.trial(AXES).log_evidence
    assert degrees_between(again.trial.rotation, AXES) < 0.1


def test_out_of_steps(searches: dict[str, RotationSearch], monkeypatch: pytest.MonkeyPatch) -> None:
    """Says so, and still ends no lower than it began."""
    monkeypatch.setattr(rotation_search, "MOST_STEPS", 1)
    one = searches["satin"]
    start = one.trial(turned(AXES[0], 6))
    summit = one.climb(start)
    assert not summit.converged
    assert summit.trial.log_evidence > start.log_evidence


def test_what_is_expected_holds_it_back(room: HarmonicBasis, photographs: dict[str, Tensor]) -> None:
    """Sure that the light is hardly turned, it ends where the pulls of the prior and of the evidence are equal."""
    start, expected = turned(torch.tensor([1.0, 2.0, -0.5]), 3), radians(0.4)
    one = search(room, photographs["clay"], expected)
    summit = one.climb(one.trial(start))
    turn = rotation_vector(summit.trial.rotation @ start.T)
    assert 0.2 < degrees(float(turn.norm())) < 2.5
    step = radians(0.1)
    pull = [
        one.trial(turned(axis, 0.1) @ summit.trial.rotation).log_evidence
        - one.trial(turned(axis, -0.1) @ summit.trial.rotation).log_evidence
        for axis in AXES
    ]
    evidence = torch.tensor(pull, dtype=torch.float64) / (2 * step)
    assert float((evidence - turn / expected**2).norm()) < 0.1 * float(evidence.norm())
    spread = torch.linalg.inv(summit.precision).diagonal().sqrt()
    assert float(spread.max()) < expected


class Bump(RotationSearch):
    """In place of the evidence a Gaussian bump of turns about a rotation, known in closed form."""

    def __init__(self, top: Tensor, width: float, slope: float = 1) -> None:
        self.top, self.width, self.slope, self.expected = top, width, slope, EXPECTED

    def away(self, rotation: Tensor) -> Tensor:
        return rotation_vector(rotation @ self.top.T)

    def trial(self, rotation: Tensor) -> Trial:
        height = 7 - 0.5 * float(self.away(rotation).square().sum()) / self.width**2
        return Trial(rotation, None, None, None, None, height)

    def _slope(self, trial: Trial) -> tuple[Tensor, Tensor]:
        return -self.slope * self.away(trial.rotation) / self.width**2, AXES / self.width**2


@pytest.mark.parametrize("width", [0.5, 5.0, 500.0])
def test_evidence_of_all_rotations(width: float) -> None:
    """A Gaussian over a Gaussian: log N(3 degrees; 0, w^2 + E^2) / N(0; 0, w^2); the start is turned itself."""
    start, axis = turned(AXES[1], 90), torch.tensor([1.0, 2.0, -2.0])
    bump = Bump(turned(axis, 3) @ start, radians(width))
    summit = bump.climb(bump.trial(start))
    expected = 7 - 0.5 * 9 / (width**2 + 25) - 1.5 * log(1 + 25 / width**2)
    assert summit.log_evidence == pytest.approx(expected, abs=0.01)
    assert summit.converged


def test_a_short_step_is_shown_ahead() -> None:
    """From 3 degrees off, where no step of less than 5 is taken: a parabola has its top there."""
    bump = Bump(turned(AXES[0], 3), radians(4))
    start = bump.trial(AXES)
    summit = bump.climb(start, radians(5))
    assert summit.trial is start
    prior = 1 / (1 + (4 / 5) ** 2)
    assert degrees_between(summit.ahead, turned(AXES[0], 3 * prior)) < 1e-3
    assert summit.hope == pytest.approx(4 * 0.5 * 9 / 16 * prior, rel=1e-6)


def test_no_step_leads_higher() -> None:
    """Where the slope is wrong, steps are shortened and then given up: not the end of a search."""
    bump = Bump(turned(AXES[0], 3), radians(1), slope=-1)
    start = bump.trial(AXES)
    summit = bump.climb(start)
    assert summit.trial is start
    assert not summit.converged


def test_far_from_no_turn(quarter_library: MaterialLibrary, photographs: dict[str, Tensor]) -> None:
    """A step turns what has been turned already: about the world's axes, not about the probe's."""
    truth = turn_about((1, 1, 0.3), 120)
    light = HarmonicBasis(quarter_library, LightProbe.default(64).rotated(truth.T), VIEW)
    one = search(light, photographs["satin"])
    summit = one.climb(one.trial(turned(torch.tensor([2.0, -1.0, 1.0]), 5) @ truth))
    assert degrees_between(summit.trial.rotation, truth) < 0.2
    assert one.evaluations < 7


def test_never_ends_lower(searches: dict[str, RotationSearch], monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where the slope points the wrong way."""
    slope = RotationSearch._slope

    def wrong(task: RotationSearch, trial: Trial) -> tuple[Tensor, Tensor]:
        gradient, precision = slope(task, trial)
        return -gradient, precision

    monkeypatch.setattr(RotationSearch, "_slope", wrong)
    start = searches["clay"].trial(turned(AXES[2], 2))
    assert searches["clay"].climb(start).trial is start


def test_what_the_light_does_not_tell(quarter_library: MaterialLibrary, photographs: dict[str, Tensor]) -> None:
    """Under light that is the same from everywhere nothing moves, and what was expected is left."""
    one = search(HarmonicBasis(quarter_library, LightProbe(torch.ones(3, 16, 32)), VIEW), photographs["paint"])
    start = one.trial(AXES)
    summit = one.climb(start)
    assert summit.trial is start
    assert summit.converged
    torch.testing.assert_close(summit.precision, AXES / EXPECTED**2, rtol=1e-3, atol=1e-3 / EXPECTED**2)


def test_another_probe_compares(room: HarmonicBasis, photographs: dict[str, Tensor]) -> None:
    """`under` the same probe nothing changes; under one out of focus the photograph is explained worse."""
    one = search(room, photographs["brass"])
    sharp = one.trial(AXES).log_evidence
    assert one.under(room.probe).trial(AXES).log_evidence == pytest.approx(sharp, rel=1e-9)
    assert one.under(room.probe.blurred(3)).trial(AXES).log_evidence < sharp - 10
    scaled = one.under(room.probe.scaled(2)).trial(AXES).log_evidence
    assert scaled == pytest.approx(sharp, abs=1e-2)


@pytest.mark.parametrize(("behind", "expected"), [(0.0, 0.5), (2.0, 0.119), (50.0, 0.0)])
def test_a_rival_summit_leaves_more_open(behind: float, expected: float) -> None:
    """A top two degrees off, as probable as its evidence."""

    def summit(rotation: Tensor, log_evidence: float) -> Summit:
        return Summit(SimpleNamespace(rotation=rotation), AXES / radians(0.1) ** 2, log_evidence, True)

    best = summit(AXES, 7.0)
    found = best_of([summit(turned(AXES[0], 2), 7.0 - behind), best])
    covariance = torch.linalg.inv(found.precision)
    expected = AXES * radians(0.1) ** 2 + expected * torch.diag(AXES[0]) * radians(2) ** 2
    assert found.trial is (best.trial if behind else found.trial)
    torch.testing.assert_close(covariance, expected, rtol=1e-2, atol=1e-9)


def test_a_climb_on_a_known_hill_leads_to_nothing_new(searches: dict[str, RotationSearch]) -> None:
    one = searches["paint"]
    known = one.climb(one.trial(AXES))
    assert one.climb_beside(one.trial(turned(AXES[0], 1)), known) is None


def test_a_better_summit_is_reached_beside_a_known_one(searches: dict[str, RotationSearch]) -> None:
    one = searches["paint"]
    aside = one.trial(turned(AXES[1], 20))
    found = one.climb_beside(one.trial(turned(AXES[0], 2)), Summit(aside, AXES, aside.log_evidence, True))
    assert found is not None
    assert degrees_between(found.trial.rotation, AXES) < 0.15


def test_where_nothing_is_hoped_for_nothing_is_looked_at(
    searches: dict[str, RotationSearch], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = searches["paint"]
    known, start = one.climb(one.trial(AXES)), one.trial(turned(AXES[0], 15))
    monkeypatch.delattr(RotationSearch, "_slope")
    assert one.climb_beside(start, known, 1.0) is None


@pytest.mark.parametrize("material", ["paint", "brass", "satin", "clay"])
def test_coarse_searches_lead_near_the_top(searches: dict[str, RotationSearch], material: str) -> None:
    one = searches[material]
    believed = one.trial(turned(torch.tensor([1.0, 2.0, -1.0]), 6))
    coarse = one.coarse(believed)
    summit = coarse.climb(coarse.trial(believed.rotation), radians(0.5))
    assert degrees_between(summit.ahead, AXES) < 1


@pytest.mark.parametrize("material", ["paint", "brass", "satin", "clay"])
@pytest.mark.parametrize("angle", [0.0, 1.0, 10.0])
def test_promising_priors_hold_the_evidence_of_all(
    searches: dict[str, RotationSearch], material: str, angle: float
) -> None:
    one, rotation = searches[material], turned(torch.tensor([1.0, -1.0, 2.0]), angle)
    promising, every = one.trial(rotation), one.trial(rotation, every=True)
    assert len(promising.explanation.bank.variances) < len(every.explanation.bank.variances)
    assert promising.log_evidence == pytest.approx(every.log_evidence, abs=0.02)


@pytest.mark.parametrize(
    ("degrees_away", "behind", "gain", "outdone"),
    [
        pytest.param(0.1, 1.0, 0.0, True, id="same hill"),
        pytest.param(0.1, -1.0, 0.0, False, id="higher"),
        pytest.param(5.0, 1.0, 0.0, False, id="another hill"),
        pytest.param(5.0, 50.0, 10.0, True, id="hopeless"),
        pytest.param(5.0, 50.0, 45.0, False, id="hopeful"),
    ],
)
def test_what_a_summit_outdoes(degrees_away: float, behind: float, gain: float, outdone: bool) -> None:
    top = SimpleNamespace(rotation=AXES, log_evidence=0.0)
    trial = SimpleNamespace(rotation=turned(AXES[0], degrees_away), log_evidence=-behind)
    summit = Summit(top, AXES / radians(0.1) ** 2, 0.0, True)
    assert summit.outdoes(trial, gain, radians(0.3)) is outdone


def test_corrected_changes_explain_the_last_turn(searches: dict[str, RotationSearch]) -> None:
    """To first order they lead from the image before to that after, and stay near what a rendering shows of them."""
    one = searches["satin"]
    before = one.trial(turned(AXES[0], 3))
    one.turns(before)
    after = one.trial(turned(torch.tensor([1.0, -1.0, 0.5]), 0.5) @ before.rotation)
    corrected = one.turns(after)
    one.turns(one.trial(turned(AXES[1], 30)))  # too far away: what comes next is rendered
    rendered = one.turns(after)
    turn = rotation_vector(after.rotation @ before.rotation.T)
    moved = after.basis.packed.double() - before.basis.packed.double()
    expected = torch.einsum("sn,nsp->sp", likeliest(after.explanation)[2], moved)
    torch.testing.assert_close(torch.einsum("a,asp->sp", turn, corrected), expected, rtol=1e-3, atol=1e-5)
    assert float((corrected - rendered).norm()) < 0.2 * float(rendered.norm())
