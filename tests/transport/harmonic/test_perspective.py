"""Balls in perspective and off the axis: closed forms, the sampled transport as an oracle, orientations, refusals."""

import math

import pytest
import torch
from torch import Tensor

from coarse_grids import QUARTER_GRID, computed_on
from materials import lambert
from probes import lamps, probe_of, relative
from torchbrdf.brdf.directions import half_difference
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.transport.harmonic.basis import HarmonicBasis
from torchbrdf.transport.harmonic.views import NEAREST, unsuited
from torchbrdf.view.sphere import SphereView
from turns import turn_about

ALBEDO = (0.8, 0.5, 0.2)
SIZE = 16
ASIDE = (0.3, -0.2, -1.0)
"""Towards a ball 20 degrees off the axis."""

MOST = 5e-3
"""Relative error of an image; the sampled transport's own is 0.1 to 0.2 %."""


def fov_of(distance: float) -> float:
    """Degrees across a ball so many radii away."""
    return 2 * math.degrees(math.asin(1 / distance))


def plastic(w_i: Tensor, w_o: Tensor) -> Tensor:
    """A lobe that Fresnel's term multiplies by twenty towards grazing angles [Sch94]."""
    theta_h, theta_d, _ = half_difference(w_i, w_o)
    fresnel = 0.04 + 0.96 * (1 - torch.cos(theta_d)) ** 5
    lobe = torch.exp(-((torch.tan(theta_h.clamp_max(1.5)) / 0.15) ** 2)) / (math.pi * 0.15**2)
    return (fresnel * lobe / (4 * (w_i[..., 2] * w_o[..., 2]).clamp_min(0.05)))[..., None].expand(*w_i.shape[:-1], 3)


@pytest.fixture(scope="module")
def library() -> MaterialLibrary:
    """Matte and plastic; precomputed on first use."""
    with computed_on(QUARTER_GRID):
        functions = {"matte": lambert(*ALBEDO), "plastic": plastic}
        yield MaterialLibrary.from_tables([MerlTable.from_function(f_r, name) for name, f_r in functions.items()])


def harmonic(library: MaterialLibrary, probe: LightProbe, view: SphereView) -> Tensor:
    return render_basis(library, probe, view, backend="harmonic").packed


def worst(found: Tensor, expected: Tensor) -> float:
    return max(relative(one, other) for one, other in zip(found, expected, strict=True))


class TestClosedForms:
    @pytest.mark.parametrize("distance", [6.0, 14.0, 200.0])
    def test_uniform_light_shows_the_albedo(self, library: MaterialLibrary, distance: float) -> None:
        view = SphereView(SIZE, fov_deg=fov_of(distance))
        packed = harmonic(library.subset(["matte"]), LightProbe(torch.ones(3, 32, 64)), view)
        assert relative(packed, torch.tensor(ALBEDO)[:, None, None].expand_as(packed)) < 2e-3

    @pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.48, -0.6, 0.64)])
    @pytest.mark.parametrize("direction", [(0.0, 0.0, -1.0), ASIDE])
    @pytest.mark.parametrize("fov_deg", [None, 12.0])
    def test_linear_light(
        self,
        library: MaterialLibrary,
        axis: tuple[float, ...],
        direction: tuple[float, float, float],
        fov_deg: float | None,
    ) -> None:
        """[RH01]: what a matte surface shows depends on its normal alone, wherever the camera stands."""
        along, view = torch.tensor(axis), SphereView(SIZE, fov_deg=fov_deg, direction=direction)
        packed = harmonic(library.subset(["matte"]), probe_of(lambda d: 1 + d @ along), view)
        steps = (torch.arange(10) + 0.5) / 10
        u, v = (places.expand(len(view.pixels), -1) for places in torch.cartesian_prod(steps, steps).T)
        normals = view.surface(view.pixels, u, v).normals
        expected = ALBEDO[0] * (1 + 2 / 3 * torch.einsum("kqs,k->qs", normals, along)).mean(1)
        assert relative(packed[0], expected.expand(3, -1)) < 2e-3


class TestOracle:
    @pytest.mark.parametrize("distance", [6.0, 8.0, 12.0, 20.0, 40.0])
    def test_under_lamps(self, library: MaterialLibrary, distance: float) -> None:
        view = SphereView(SIZE, fov_deg=fov_of(distance))
        expected = render_basis(library, lamps(64), view, "sampled", 8192).packed
        assert worst(harmonic(library, lamps(64), view), expected) < MOST

    @pytest.mark.parametrize("distance", [8.0, 12.0, 20.0])
    def test_under_light_from_behind(self, library: MaterialLibrary, distance: float) -> None:
        """The rim mirrors it at grazing angles, where a material changes most with the view direction."""
        probe = probe_of(lambda d: 1 - d[..., 2])
        view = SphereView(SIZE, fov_deg=fov_of(distance))
        expected = render_basis(library, probe, view, "sampled", 8192).packed
        assert worst(harmonic(library, probe, view), expected) < MOST

    def test_off_the_axis(self, library: MaterialLibrary) -> None:
        view = SphereView(SIZE, fov_deg=fov_of(9), direction=ASIDE)
        expected = render_basis(library, lamps(64), view, "sampled", 8192).packed
        assert worst(harmonic(library, lamps(64), view), expected) < MOST

    def test_without_perspective_it_would_be_far_off(self, library: MaterialLibrary) -> None:
        view = SphereView(SIZE, fov_deg=fov_of(12))
        orthographic = harmonic(library, lamps(64), SphereView(SIZE))
        assert relative(harmonic(library, lamps(64), view), orthographic) > 4 * MOST

    def test_from_far_away_it_is_orthographic(self, library: MaterialLibrary) -> None:
        orthographic = harmonic(library, lamps(64), SphereView(SIZE))
        assert relative(harmonic(library, lamps(64), SphereView(SIZE, fov_deg=fov_of(1e5))), orthographic) < 1e-4


class TestTurning:
    """A ball off the axis is one on the axis under a turned probe."""

    TURN = turn_about((1, -2, 1.5), 25)

    @pytest.fixture(params=[None, 10.0])
    def aside(self, library: MaterialLibrary, request: pytest.FixtureRequest) -> HarmonicBasis:
        return HarmonicBasis(library, lamps(64), SphereView(SIZE, fov_deg=request.param, direction=ASIDE))

    def test_as_on_the_axis(self, library: MaterialLibrary, aside: HarmonicBasis) -> None:
        ahead = HarmonicBasis(library, lamps(64), SphereView(SIZE, fov_deg=aside.view.fov_deg))
        for rotation in (torch.eye(3, dtype=torch.float64), self.TURN):
            expected = ahead.basis_at(aside.view.rotation.T @ rotation).packed
            assert relative(aside.basis_at(rotation).packed, expected) < 1e-6
        assert relative(aside.basis_at().packed, ahead.basis_at(aside.view.rotation.T).packed) < 1e-6

    def test_says_where_it_comes_from(self, aside: HarmonicBasis) -> None:
        basis = aside.basis_at()
        assert (basis.probe, basis.view) == (lamps(64).fingerprint, aside.view.fingerprint)

    def test_image_at(self, library: MaterialLibrary, aside: HarmonicBasis) -> None:
        weights = torch.randn(library.n, 3, generator=torch.Generator().manual_seed(1))
        expected = torch.einsum("nc,ncp->cp", weights, aside.basis_at(self.TURN).packed)
        assert relative(aside.image_at(weights, self.TURN), expected) < 1e-5

    def test_change_at(self, library: MaterialLibrary) -> None:
        """About the camera's own axes, against two whole images."""
        probe = probe_of(lambda d: 1 + 0.7 * d[..., 0] + 0.4 * d[..., 1] * d[..., 2] - 0.3 * d[..., 1])
        basis = HarmonicBasis(library, probe, SphereView(SIZE, fov_deg=10.0, direction=ASIDE))
        weights = torch.randn(library.n, 3, generator=torch.Generator().manual_seed(2))
        found = basis.change_at(weights, self.TURN)
        for axis in range(3):
            about = [float(axis == k) for k in range(3)]
            after, before = (basis.image_at(weights, turn_about(about, sign * 2) @ self.TURN) for sign in (1, -1))
            assert relative(found[axis], (after - before) / math.radians(4)) < 0.01

    def test_gradients(self, library: MaterialLibrary) -> None:
        """Of the rotation, which the frame of the ball turns on, and of the radiance."""
        radiance = probe_of(lambda d: 1 + 0.7 * d[..., 0] + 0.4 * d[..., 1] * d[..., 2]).radiance.requires_grad_()
        basis = HarmonicBasis(library, LightProbe(radiance), SphereView(SIZE, fov_deg=10.0, direction=ASIDE))
        weights = torch.randn(library.n, 3, generator=torch.Generator().manual_seed(3))
        field = torch.randn(3, len(basis.view.pixels), generator=torch.Generator().manual_seed(4))
        turn = torch.zeros(3, requires_grad=True)
        x, y, z = turn
        zero = torch.zeros(())
        generator = torch.stack([torch.stack(row) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])])
        image = basis.image_at(weights, (torch.eye(3) + generator) @ self.TURN.float())
        (image * field).sum().backward()
        assert turn.grad is not None
        assert radiance.grad is not None
        expected = (basis.change_at(weights, self.TURN) * field).sum((1, 2))
        assert float((turn.grad - expected.detach()).norm()) < 0.02 * float(expected.detach().norm())
        total = float((radiance.grad * radiance.detach()).sum())
        assert total == pytest.approx(float((image.detach() * field).sum()), rel=1e-3)


class TestLimit:
    def test_nearer_than_what_is_held(self, library: MaterialLibrary) -> None:
        message = (
            r'^backend="harmonic" cannot render this view: the camera of SphereView\(12, fov_deg=40, 88 pixels\) is '
            r"2.92 radii from the ball's middle, nearer than 6 \(fov_deg=19.2\); use backend=\"sampled\"$"
        )
        with pytest.raises(ValueError, match=message):
            harmonic(library, lamps(), SphereView(12, fov_deg=40))

    def test_what_it_says_is_served(self) -> None:
        assert unsuited(SphereView(12, fov_deg=19.2)) is None
        assert unsuited(SphereView(12, fov_deg=fov_of(NEAREST))) is None
        assert unsuited(SphereView(12, fov_deg=19.3)) is not None
