"""Alignment: photographs by the sampled transport of materials outside the library, under probes that are turned.

The photographs show the probe as it is, and `align` is given a turned one: what it finds has to turn that back.
"""

from collections.abc import Callable
from dataclasses import replace
from math import radians
from pathlib import Path

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from probes import probe_of
from torchbrdf.alignment._search import RotationSearch, Summit, Trial
from torchbrdf.alignment.alignment import CONFIDENT, EXPECTED, Alignment, align, dominated
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.images.difference import relative_rms
from torchbrdf.light.probe import LightProbe
from torchbrdf.transport.harmonic.basis import HarmonicBasis
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView
from torchbrdf.view.view import View
from turns import degrees_between, turn_about

ROOM = LightProbe.default(64)
VIEW = SphereView(48)
STRAIGHT = torch.eye(3, dtype=torch.float64)
TURN = turn_about((1, -2, 1.5), 4)
"""What is to be found."""

GIVEN = ROOM.rotated(TURN.T)


@pytest.fixture(scope="module")
def aligned(quarter_library: MaterialLibrary) -> Callable[..., Alignment]:
    """`align` with defaults for everything but the photograph."""

    def run(image: Tensor, probe: LightProbe = GIVEN, view: View = VIEW, **options: object) -> Alignment:
        return align(image, probe, view, quarter_library, **options)

    return run


@pytest.fixture(scope="module")
def found(aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> Alignment:
    """Glossy paint under a probe turned by 4 degrees."""
    return aligned(photographs["paint"])


def noisy(image: Tensor, share: float, seed: int = 0) -> Tensor:
    return image * (1 + share * torch.randn(image.shape, generator=torch.Generator().manual_seed(seed)))


def random_turn(seed: int) -> Tensor:
    """By up to 5 degrees about any axis."""
    generator = torch.Generator().manual_seed(seed)
    axis, angle = torch.randn(3, generator=generator), 5 * torch.rand(1, generator=generator)
    return turn_about(axis.tolist(), float(angle))


class TestPerspective:
    def test_a_ball_off_the_axis(
        self, tiny_tables: dict[str, MerlTable], strangers: dict[str, MerlTable], quarter_grid: None
    ) -> None:
        """The camera's frame is the probe's, wherever in it the ball is."""
        names = ("red", "plastic-0.2", "plastic-0.1", "white")
        library = MaterialLibrary.from_tables([tiny_tables[name] for name in names])
        view = SphereView(32, fov_deg=8.0, direction=(0.15, 0.1, -1.0))
        found = align(tb.render(strangers["paint"], ROOM, view, 1024), GIVEN, view, library)
        assert degrees_between(found.rotation, TURN) < 0.2
        assert found.confident


class TestTurnedProbe:
    @pytest.mark.parametrize(("material", "seed"), [("paint", 1), ("brass", 2), ("satin", 3)])
    def test_little_is_left(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], material: str, seed: int
    ) -> None:
        """Of a random rotation, with 1 % noise: the figure of glossy materials in docs/alignment.md."""
        rotation = random_turn(seed)
        found = aligned(noisy(photographs[material], 0.01, seed), ROOM.rotated(rotation.T))
        assert degrees_between(STRAIGHT, rotation) > 0.8
        assert degrees_between(found.rotation, rotation) < 0.2
        assert found.confident
        assert found.log_odds > 0

    def test_what_is_found(self, found: Alignment, quarter_library: MaterialLibrary) -> None:
        """R of `LightProbe.rotated`; the probe and the basis are the given ones turned by it."""
        assert found.rotation.shape == found.covariance.shape == (3, 3)
        assert found.rotation.dtype == found.covariance.dtype == torch.float64
        torch.testing.assert_close(found.rotation @ found.rotation.T, STRAIGHT)
        assert degrees_between(found.rotation, TURN) < 0.1
        assert found.angle == pytest.approx(4, abs=0.1)
        assert torch.equal(found.probe.radiance, GIVEN.rotated(found.rotation).radiance)
        basis = HarmonicBasis(quarter_library, GIVEN, VIEW).basis_at(found.rotation)
        assert torch.equal(found.basis.packed, basis.packed)
        assert (found.basis.names, found.basis.library) == (quarter_library.names, quarter_library.source)
        assert (found.blur, found.exposure) == (0.0, None)
        assert found.evaluations >= 2

    def test_explains_the_photograph(
        self, found: Alignment, photographs: dict[str, Tensor], strangers: dict[str, MerlTable]
    ) -> None:
        """Rendered anew under what was found, the true material looks like its photograph; as given, it does not."""
        errors = [
            relative_rms(tb.render(strangers["paint"], probe, VIEW, samples=512), photographs["paint"])
            for probe in (found.probe, GIVEN, GIVEN.rotated(found.rotation.T))
        ]
        assert errors[0] < 0.03
        assert errors[1] > 3 * errors[0]
        assert errors[2] > errors[1]

    def test_what_is_left_open(self, found: Alignment) -> None:
        covariance = found.covariance
        torch.testing.assert_close(covariance, covariance.T)
        spread = torch.linalg.eigvalsh(covariance)
        assert float(spread[0]) > 0
        assert found.uncertainty == pytest.approx(float(spread[-1].sqrt().rad2deg()))
        assert found.uncertainty < 0.3
        assert degrees_between(found.rotation, TURN) < 4 * found.uncertainty

    def test_said_in_words(self, found: Alignment) -> None:
        text = str(found)
        assert "\n" not in text
        assert text.startswith(f"light probe turned by {found.angle:.2f} degrees about (")
        x, y, z = (float(value) for value in text.split("(")[1].split(")")[0].split(","))
        direction = torch.nn.functional.normalize(torch.tensor([1, -2, 1.5]), dim=0)
        torch.testing.assert_close(torch.tensor([x, y, z]), direction, rtol=0, atol=0.03)
        assert f"(standard deviation {found.uncertainty:.2f} degrees about the least certain axis)" in text


class TestRightProbe:
    @pytest.mark.parametrize("material", ["brass", "clay"])
    def test_stays_as_it_is(
        self,
        aligned: Callable[..., Alignment],
        photographs: dict[str, Tensor],
        quarter_library: MaterialLibrary,
        material: str,
    ) -> None:
        """Exactly: no rotation, the same radiance, the same basis; and no odds that it was turned."""
        found = aligned(noisy(photographs[material], 0.01), ROOM)
        assert torch.equal(found.rotation, STRAIGHT)
        assert torch.equal(found.probe.radiance, ROOM.radiance)
        expected = HarmonicBasis(quarter_library, ROOM, VIEW).basis_at()
        torch.testing.assert_close(found.basis.packed, expected.packed, rtol=1e-5, atol=1e-6)
        assert found.angle == 0
        assert found.log_odds < 0
        assert not found.turned
        assert found.confident
        assert str(found).startswith(
            "light probe left as it is: no turn explains the photograph clearly better (standard deviation "
        )


class TestStart:
    """A rotation that is believed, of a photograph before for example."""

    def test_is_kept_where_it_is_right(self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> None:
        found = aligned(photographs["paint"], start=TURN)
        torch.testing.assert_close(found.rotation, TURN)
        assert torch.equal(found.probe.radiance, GIVEN.rotated(TURN).radiance)
        assert found.log_odds < 0
        assert not found.turned
        assert found.angle == pytest.approx(4)
        assert str(found).startswith(
            "light probe kept turned by 4.00 degrees about (0.37, -0.74, 0.56), as believed: "
            "no other turn explains the photograph clearly better (standard deviation "
        )

    def test_is_left_where_it_is_wrong(self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> None:
        """The odds are those against the start, here by 8 degrees."""
        found = aligned(photographs["paint"], start=TURN.T.float())
        assert degrees_between(found.rotation, TURN) < 0.1
        assert found.log_odds > 5
        assert found.turned

    @pytest.mark.parametrize("start", [torch.eye(4), -torch.eye(3)])
    def test_is_no_rotation(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], start: Tensor
    ) -> None:
        with pytest.raises(ValueError, match=r"^rotation must be (\(3, 3\)|orthonormal)[^\n]*$"):
            aligned(photographs["paint"], start=start)


class TestUntold:
    """It says when the photograph cannot tell, instead of inventing a rotation."""

    @pytest.mark.parametrize("search", ["near", "full"])
    def test_white_furnace(self, aligned: Callable[..., Alignment], search: str) -> None:
        found = aligned(0.5 * VIEW.mask.expand(3, -1, -1).float(), LightProbe(torch.ones(3, 16, 32)), search=search)
        assert torch.equal(found.rotation, STRAIGHT)
        assert not found.confident
        spread = found.covariance.diagonal() / EXPECTED**2
        torch.testing.assert_close(spread[[0, 2]], torch.ones(2).double(), rtol=0.02, atol=0)
        assert float(spread[1]) == pytest.approx(1, rel=0.02) if search == "near" else float(spread[1]) > 0.98
        assert found.log_odds <= 1e-6
        assert "more than this photograph can tell for sure" in str(found)

    def test_matte_ball_under_soft_light(
        self, aligned: Callable[..., Alignment], strangers: dict[str, MerlTable]
    ) -> None:
        """One part of noise in a hundred hides a turn by four degrees; nothing worse than the given probe comes out."""
        soft = ROOM.blurred(75)
        image = noisy(tb.render(strangers["clay"], soft, VIEW, samples=1024), 0.01)
        right, turned = (aligned(image, probe) for probe in (soft, soft.rotated(TURN.T)))
        for found in (right, turned):
            assert not found.confident
            assert found.uncertainty > 2
        assert torch.equal(right.rotation, STRAIGHT)
        assert degrees_between(turned.rotation, TURN) <= degrees_between(STRAIGHT, TURN) + 1e-9

    def test_light_that_is_the_same_all_around(
        self, aligned: Callable[..., Alignment], strangers: dict[str, MerlTable]
    ) -> None:
        """Rings about +Y tell a tilt about +X and +Z, and no turn about +Y."""
        rings = probe_of(lambda d: 0.05 + 20 * torch.exp(-(((d[..., 1] - 0.5) / 0.15) ** 2)))
        image = tb.render(strangers["brass"], rings, VIEW, samples=1024)
        rotation = turn_about((1, 0, 0), 3)
        found = aligned(image, rings.rotated(rotation.T))
        assert degrees_between(found.rotation, rotation) < 0.3
        assert not found.confident
        values, axes = torch.linalg.eigh(found.covariance)
        assert abs(float(axes[1, 2])) > 0.99
        assert found.uncertainty == pytest.approx(5, abs=0.5)
        assert float(values[1].sqrt().rad2deg()) < 0.5

    def test_noise(self, aligned: Callable[..., Alignment]) -> None:
        """No photograph at all."""
        found = aligned(torch.rand(3, 48, 48, generator=torch.Generator().manual_seed(0)), ROOM)
        assert torch.equal(found.rotation, STRAIGHT)
        assert not found.confident

    @pytest.mark.parametrize("angle", [1.5, 2.5])
    def test_is_not_sure_of_a_rotation_that_is_wrong(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], angle: float
    ) -> None:
        """Whatever it decides with the few pixels of a small photograph: sure of it, it is right to a degree."""
        small = SphereView(16)
        image = torch.nn.functional.avg_pool2d(photographs["paint"], 3)
        rotation = turn_about((1, -2, 1.5), angle)
        found = aligned(noisy(image, 0.01), ROOM.rotated(rotation.T), small)
        assert not found.confident or degrees_between(found.rotation, rotation) < 1

    def test_one_pixel(self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> None:
        mask = torch.zeros(1, 48, 48, dtype=torch.bool)
        mask[0, 18, 26] = True
        found = aligned(photographs["paint"], mask=mask)
        assert torch.equal(found.rotation, STRAIGHT)
        assert not found.confident
        assert bool(torch.isfinite(found.covariance).all())

    def test_how_sure_is_sure(self, found: Alignment) -> None:
        """A degree about the least certain axis, and a search that ended by itself."""
        spread = torch.diag(torch.tensor([0.1, 1.0, 0.1], dtype=torch.float64) * CONFIDENT) ** 2
        assert radians(1) == CONFIDENT
        assert replace(found, covariance=0.99 * spread).confident
        assert not replace(found, covariance=1.01 * spread).confident
        assert not replace(found, covariance=0.99 * spread, converged=False).confident
        assert replace(found, covariance=spread).uncertainty == pytest.approx(1)

    def test_a_search_that_did_not_end_is_told(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        climb = RotationSearch.climb
        monkeypatch.setattr(RotationSearch, "climb", lambda *start: replace(climb(*start), converged=False))
        found = aligned(photographs["paint"], ROOM)
        assert not found.converged
        assert not found.confident


class TestFullSearch:
    """Turns about the vertical by any angle."""

    @pytest.mark.parametrize("angle", [127, 180])
    def test_finds_the_slope_of_the_right_peak(
        self,
        aligned: Callable[..., Alignment],
        photographs: dict[str, Tensor],
        monkeypatch: pytest.MonkeyPatch,
        angle: float,
    ) -> None:
        """Before any climb it is within half a step of 15 degrees."""

        def no_climb(task: RotationSearch, start: Trial) -> Summit:
            return Summit(start, STRAIGHT / radians(0.1) ** 2, start.log_evidence, True)

        monkeypatch.setattr(RotationSearch, "climb", no_climb)
        rotation = turn_about((0, 1, 0), angle)
        found = aligned(photographs["paint"], ROOM.rotated(rotation.T), search="full")
        assert degrees_between(found.rotation, rotation) <= 7.5
        assert found.evaluations >= 24

    def test_finds_the_rotation(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor]
    ) -> None:
        """With a tilt beside it."""
        rotation = turn_about((0, 1, 0), 60) @ turn_about((1, 0, 0.5), 4)
        found = aligned(photographs["brass"], ROOM.rotated(rotation.T), search="full")
        assert degrees_between(found.rotation, rotation) < 0.2
        assert found.confident
        assert found.angle == pytest.approx(degrees_between(rotation, STRAIGHT), abs=0.2)


class TestPhotograph:
    def test_its_scale_and_precision(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], found: Alignment
    ) -> None:
        """Change nothing."""
        scaled = aligned(1e3 * photographs["paint"].double())
        assert degrees_between(scaled.rotation, found.rotation) < 1e-3
        assert scaled.log_odds == pytest.approx(found.log_odds, abs=1e-2)
        torch.testing.assert_close(scaled.covariance, found.covariance, rtol=1e-2, atol=1e-9)

    def test_again(self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], found: Alignment) -> None:
        """The same to the last bit, whatever lies outside the sphere."""
        image = torch.where(VIEW.mask, photographs["paint"], float("nan"))
        again = aligned(image, mask=VIEW.mask)
        assert torch.equal(again.rotation, found.rotation)
        assert torch.equal(again.covariance, found.covariance)
        assert again.log_odds == found.log_odds
        assert torch.equal(again.basis.packed, found.basis.packed)

    @pytest.mark.parametrize("masked", ["half", "saturated"])
    def test_masks(self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], masked: str) -> None:
        """Half of the sphere in the dark of a NaN; highlights that the sensor clipped. A thousandth as bright."""
        image = 1e-3 * photographs["paint"]
        if masked == "half":
            mask = torch.zeros_like(VIEW.mask)
            mask[:, :, :24] = True
            image[:, ~mask[0]] = float("nan")
        else:
            level = float(image[:, VIEW.mask[0]].quantile(0.95))
            mask = (image < level).all(0)[None]
            image = image.clamp_max(level)
        found = aligned(image, mask=mask)
        assert degrees_between(found.rotation, TURN) < 0.2
        assert found.confident
        assert found.basis.packed.shape[-1] == len(VIEW.pixels)

    def test_of_another_shape(self, aligned: Callable[..., Alignment], strangers: dict[str, MerlTable]) -> None:
        """Hills and valleys."""
        y, x = torch.meshgrid(torch.linspace(-1, 1, 18), torch.linspace(-1, 1, 18), indexing="ij")
        shape = NormalMapView(torch.stack([-torch.sin(3 * x) * torch.cos(y), 0.7 * torch.cos(2 * y + x), 0 * x + 1]))
        found = aligned(tb.render(strangers["brass"], ROOM, shape, samples=512), view=shape)
        assert degrees_between(found.rotation, TURN) < 0.2

    def test_light_without_blue(self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> None:
        """And what the photograph holds in blue is nothing to go by."""
        radiance = GIVEN.radiance * torch.tensor([1.0, 1.0, 0.0])[:, None, None]
        found = aligned(photographs["paint"], LightProbe(radiance))
        assert degrees_between(found.rotation, TURN) < 0.2
        assert bool(torch.isfinite(found.covariance).all())

    def test_negative_pixels(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], found: Alignment
    ) -> None:
        """Colours outside the gamut of RGB, as renderings of measured materials have."""
        image = photographs["paint"].clone()
        image[2] -= 0.2 * image[0]
        assert bool((image[2] < 0).any())
        assert degrees_between(aligned(image).rotation, found.rotation) < 0.2


class TestExposure:
    def test_of_the_photograph(self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> None:
        """One factor for all channels, or one for each; neither changes the rotation."""
        image, gains = photographs["satin"], torch.tensor([4.0, 1.0, 0.25])
        plain, doubled = (aligned(scale * image, ROOM, exposure=True).exposure for scale in (1, 2))
        assert plain is not None
        assert doubled is not None
        assert len(set(plain.factors.tolist())) == 1
        assert 1.1 < float(doubled.factors[0] / plain.factors[0]) < 2
        assert abs(float(plain.factors[0].log())) < float(plain.std[0])
        assert bool((plain.std > 0).all())
        balanced = aligned(gains[:, None, None] * image, ROOM, white_balance=True)
        assert balanced.exposure is not None
        red, green, blue = balanced.exposure.factors.tolist()
        assert red > 1.1 * green > 1.2 * blue
        assert torch.equal(balanced.rotation, STRAIGHT)
        assert str(balanced).endswith(f"; {balanced.exposure}")


class TestBadInput:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"search": "far"}, r"search must be one of near, full, got 'far'"),
            ({"image": torch.ones(1, 3, 48, 48)}, r"align takes one photograph \(3, H, W\), got a batch \(1,\); .*"),
            ({"image": torch.ones(3, 32, 32)}, r"image must be .*\(\*batch, 3, 48, 48\) .*, got \(3, 32, 32\)"),
            ({"image": torch.ones(48, 48)}, r"image must be .*, got \(48, 48\)"),
            ({"image": torch.ones(3, 48, 48).half()}, r"image must be float32 or float64 .*, got torch.float16; .*"),
            ({"image": torch.zeros(3, 48, 48)}, r".*is black: every pixel under the mask is 0"),
            ({"image": torch.full((3, 48, 48), float("nan"))}, r"image holds NaN or infinite values, in 1696 of .*"),
            ({"mask": torch.zeros(1, 48, 48, dtype=torch.bool)}, r"mask leaves no pixel of the view to use.*"),
            ({"mask": torch.ones(48, 48, dtype=torch.bool)}, r"mask must be bool \(1, 48, 48\).*\(48, 48\)"),
            ({"mask": torch.ones(1, 48, 48)}, r"mask must be bool \(1, 48, 48\).*, got torch.float32 .*"),
        ],
    )
    def test_photographs(
        self, aligned: Callable[..., Alignment], change: dict[str, object], message: str
    ) -> None:
        options = {"image": torch.ones(3, 48, 48), **change}
        with pytest.raises(ValueError, match=f"^{message}$") as caught:
            aligned(**options)
        assert "\n" not in str(caught.value)

    def test_perspective(self, aligned: Callable[..., Alignment]) -> None:
        """Says what the view lacks, and nothing about a backend that `align` does not have."""
        view = SphereView(48, fov_deg=40)
        message = r"^[^\n]*SphereView\(48, fov_deg=40, 1696 pixels\) is 2.92 radii from [^\n]*$"
        with pytest.raises(ValueError, match=message) as caught:
            aligned(torch.ones(3, 48, 48), view=view)
        assert "backend" not in str(caught.value)

    @pytest.mark.usefixtures("mitsuba")
    def test_mesh(self, aligned: Callable[..., Alignment], tmp_path: Path) -> None:
        trimesh = pytest.importorskip("trimesh")
        trimesh.creation.icosphere(2).export(tmp_path / "ball.ply", vertex_normal=True)
        with pytest.raises(ValueError, match=r"^[^\n]*MeshView[^\n]*may shade itself[^\n]*$") as caught:
            aligned(torch.ones(3, 48, 48), view=tb.MeshView(tmp_path / "ball.ply", 48))
        assert "backend" not in str(caught.value)


# --- Lights of few lamps -----------------------------------------------------------------------------------


def sunny(share: float) -> LightProbe:
    """A uniform sky with a small sun that sends so much of all light."""
    sky = LightProbe(torch.ones(3, 64, 128))
    radiance = sky.radiance.clone()
    power = float(sky.solid_angles.sum())
    radiance[:, 20, 30] = power * share / (1 - share) / float(sky.solid_angles[20, 30])
    return LightProbe(radiance)


@pytest.mark.parametrize(("share", "expected"), [(0.0, False), (0.1, False), (0.4, True), (0.9, True)])
def test_lamps_that_outshine_the_rest(share: float, expected: bool) -> None:
    assert dominated(sunny(share)) == expected
