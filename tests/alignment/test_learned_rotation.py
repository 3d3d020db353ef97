"""The learned rotation: gradients against differences, a planted rotation found, weights and light that learn along."""

import functools
import sys

import pytest
import torch
from torch import Tensor

from probes import probe_of
from torchbrdf.alignment.alignment import align
from torchbrdf.alignment.learned_rotation import LearnedRotation
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.lasting import LastFew
from torchbrdf.light.probe import LightProbe
from torchbrdf.transport.harmonic import cache as harmonic_cache
from torchbrdf.transport.harmonic.basis import HarmonicBasis
from torchbrdf.view.sphere import SphereView
from turns import degrees_between, turn_about

VIEW = SphereView(16)
LINES = 288
TILT = turn_about((1, 2, -0.5), 25)


def soft() -> LightProbe:
    """Light without edges: its derivative does not jump between texels."""
    towards = torch.nn.functional.normalize(torch.tensor([[0.5, 0.6, 0.6], [-0.7, 0.1, 0.7]]), dim=1)
    return probe_of(lambda d: 0.2 + 5 * torch.exp(8 * (d @ towards[0] - 1)) + 2 * torch.exp(5 * (d @ towards[1] - 1)))


@pytest.fixture(scope="module")
def light(quarter_library: MaterialLibrary) -> HarmonicBasis:
    return HarmonicBasis(quarter_library, soft(), VIEW, lines=LINES)


def only(library: MaterialLibrary, name: str) -> Tensor:
    """(n, 3): the weights of one material."""
    weights = torch.zeros(library.n, 3)
    first = 3 * library.names.index(name)
    weights[first : first + 3] = torch.eye(3)
    return weights


def mixed(library: MaterialLibrary) -> Tensor:
    """(n, 3): weights of all materials, some negative."""
    return torch.randn(library.n, 3, generator=torch.Generator().manual_seed(4)) / library.n


@pytest.mark.parametrize("start", [None, TILT, TILT.float()])
def test_starts_where_it_is_told(light: HarmonicBasis, start: Tensor | None) -> None:
    learned = LearnedRotation(light, start)
    expected = torch.eye(3) if start is None else start.float()
    torch.testing.assert_close(learned.rotation, expected, rtol=0, atol=1e-6)
    weights = mixed(light.library)
    image = torch.einsum("nc,ncp->cp", weights, light.basis_at(expected).packed)
    torch.testing.assert_close(learned(weights), image, rtol=1e-4, atol=1e-5 * float(image.abs().max()))
    assert learned(weights).shape == (3, len(VIEW.pixels))


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (0.2, -0.3, 0.1), (2.0, 1.0, -1.5)])
def test_is_a_turn_times_the_start(light: HarmonicBasis, vector: tuple[float, ...]) -> None:
    """In this order: a further turn of what `rotation` has turned already."""
    learned = LearnedRotation(light, TILT)
    with torch.no_grad():
        learned.turn.copy_(torch.tensor(vector))
    angle = float(torch.tensor(vector).norm().rad2deg())
    turn = turn_about(vector, angle) if angle else torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close(learned.rotation, (turn @ TILT).float(), rtol=0, atol=1e-6)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.15)])
def test_gradient_of_the_turn(light: HarmonicBasis, vector: tuple[float, ...]) -> None:
    """Against differences; at no turn, too, where it starts and where 0 / 0 lurks."""
    learned, weights = LearnedRotation(light, TILT), mixed(light.library)
    field = torch.randn(3, len(VIEW.pixels), generator=torch.Generator().manual_seed(5))
    with torch.no_grad():
        learned.turn.copy_(torch.tensor(vector))
    (learned(weights) * field).sum().backward()
    assert learned.turn.grad is not None
    step, differences = 0.02, []
    for axis in torch.eye(3):
        sides = []
        for sign in (1, -1):
            with torch.no_grad():
                learned.turn.copy_(torch.tensor(vector) + sign * step * axis)
                sides.append(float((learned(weights).double() * field).sum()))
        differences.append((sides[0] - sides[1]) / (2 * step))
    expected = torch.tensor(differences)
    assert float((learned.turn.grad - expected).norm()) < 0.02 * float(expected.norm())
    assert float(expected.abs().min()) > 0.05 * float(expected.norm())


def test_gradients_of_weights_and_radiance(quarter_library: MaterialLibrary) -> None:
    """The image is linear in both: gradients are what one more unit of them adds."""
    probe = soft()
    radiance = probe.radiance.clone().requires_grad_()
    learned = LearnedRotation(HarmonicBasis(quarter_library, LightProbe(radiance), VIEW, lines=LINES), TILT)
    weights = mixed(quarter_library).requires_grad_()
    field = torch.randn(3, len(VIEW.pixels), generator=torch.Generator().manual_seed(6))
    total = (learned(weights) * field).sum()
    total.backward()
    packed = HarmonicBasis(quarter_library, probe, VIEW, lines=LINES).basis_at(TILT).packed
    expected = torch.einsum("ncp,cp->nc", packed, field)
    assert weights.grad is not None
    assert radiance.grad is not None
    torch.testing.assert_close(weights.grad, expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))
    assert float((radiance.grad * probe.radiance).sum()) == pytest.approx(float(total.detach()), rel=1e-3)
    assert learned.turn.grad is not None
    assert float(learned.turn.grad.norm()) > 0


def test_of_some_materials(light: HarmonicBasis) -> None:
    """A library that uses some of the stored columns, in another order."""
    names = ["copper-0.08", "red"]
    some = LearnedRotation(HarmonicBasis(light.library.subset(names), light.probe, VIEW, lines=LINES), TILT)
    weights = only(some.light.library, "red").requires_grad_()
    image = some(weights)
    expected = LearnedRotation(light, TILT)(only(light.library, "red"))
    torch.testing.assert_close(image, expected, rtol=1e-4, atol=1e-6)
    image.sum().backward()
    assert weights.grad is not None
    assert weights.grad.shape == (6, 3)
    assert bool((weights.grad > 0).all())


def test_finds_a_planted_rotation_and_albedos(light: HarmonicBasis) -> None:
    """One unknown of several, for any optimiser."""
    room = HarmonicBasis(light.library, LightProbe.default(64).blurred(4), VIEW, lines=LINES)
    truth, albedos = turn_about((1, -2, 1.5), 3), torch.tensor([0.7, 1.3, 0.9])
    steel = only(light.library, "steel-0.15")
    image = room.image_at(steel * albedos, truth)
    learned, level = LearnedRotation(room), torch.nn.Parameter(torch.ones(3))
    groups = [{"params": learned.parameters(), "lr": 0.02}, {"params": [level], "lr": 0.15}]
    optimiser = torch.optim.Adam(groups, betas=(0.8, 0.95))
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.87)
    assert degrees_between(learned.rotation.detach(), truth) == pytest.approx(3, abs=1e-3)
    for _ in range(22):
        optimiser.zero_grad()
        ((learned(steel * level) - image) / (image + image.mean())).square().mean().backward()
        optimiser.step()
        schedule.step()
    assert degrees_between(learned.rotation.detach(), truth) < 0.25
    torch.testing.assert_close(level.detach(), albedos, rtol=0.03, atol=0)


def test_what_is_saved(light: HarmonicBasis) -> None:
    learned = LearnedRotation(light, TILT)
    with torch.no_grad():
        learned.turn.copy_(torch.tensor([0.1, 0.2, -0.3]))
    state = learned.state_dict()
    assert {name: tuple(value.shape) for name, value in state.items()} == {"turn": (3,), "start": (3, 3)}
    again = LearnedRotation(light)
    again.load_state_dict(state)
    assert torch.equal(again.rotation, learned.rotation)
    assert [name for name, _ in learned.named_parameters()] == ["turn"]
    assert learned.turn.dtype == torch.float32


def test_leaves_its_start_alone(light: HarmonicBasis) -> None:
    start = torch.eye(3)
    learned = LearnedRotation(light, start)
    start[0, 0] = 7
    torch.testing.assert_close(learned.rotation, torch.eye(3))


@pytest.mark.parametrize(
    ("rotation", "message"),
    [
        (torch.eye(4), r"^rotation must be \(3, 3\), got \(4, 4\)$"),
        (-torch.eye(3), r"^rotation must be orthonormal with determinant \+1, got determinant -1 and [^\n]*$"),
        (2 * torch.eye(3), r"^rotation must be orthonormal with determinant \+1, got determinant 8 and [^\n]*up to 3$"),
    ],
)
def test_no_rotation(light: HarmonicBasis, rotation: Tensor, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LearnedRotation(light, rotation)


def forget() -> None:
    """Empty what the package keeps of earlier calls."""
    for name, module in list(sys.modules.items()):
        if name.startswith("torchbrdf"):
            for value in vars(module).values():
                if isinstance(value, functools._lru_cache_wrapper):
                    value.cache_clear()


def test_after_an_alignment_without_gradients(
    quarter_library: MaterialLibrary, photographs: dict[str, Tensor], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What `align` keeps for later in `torch.inference_mode` enters graphs later."""
    monkeypatch.setattr(harmonic_cache, "_in_memory", LastFew(2))
    forget()
    try:
        with torch.inference_mode():
            align(photographs["brass"], LightProbe.default(64), SphereView(48), quarter_library)
        learned = LearnedRotation(HarmonicBasis(quarter_library, LightProbe.default(64), SphereView(48)))
        learned(only(quarter_library, "red")).sum().backward()
        assert learned.turn.grad is not None
        assert float(learned.turn.grad.norm()) > 0
    finally:
        forget()
