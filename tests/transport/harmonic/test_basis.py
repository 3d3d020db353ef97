"""Harmonic transport: closed forms, the sampled transport as an oracle, orientations, gradients, views, bad input."""

import copy
import math
import pickle
from collections.abc import Callable

import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import normalize

from coarse_grids import HALF_GRID, computed_on
from materials import TINY_MATERIALS, lambert
from probes import lamps, probe_of, relative
from torchbrdf.brdf.directions import half_difference
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.transport.basis_images import BasisImages
from torchbrdf.transport.harmonic._kernels import Kernels
from torchbrdf.transport.harmonic.basis import HarmonicBasis
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView
from torchbrdf.view.view import SurfacePoints, View

SPHERE = SphereView(16)
ALBEDO = (0.8, 0.5, 0.2)


def swirl(sign: float) -> Callable[[Tensor, Tensor], Tensor]:
    """f_r that tells phi_d from -phi_d: no mirror image of itself, as no measured material is."""

    def f_r(w_i: Tensor, w_o: Tensor) -> Tensor:
        _, theta_d, phi_d = half_difference(w_i, w_o)
        wave = 1 + sign * 0.9 * torch.sin(2 * phi_d) * torch.sin(2 * theta_d)
        return (wave / math.pi)[..., None].expand(*wave.shape, 3)

    return f_r


@pytest.fixture(scope="module")
def library() -> MaterialLibrary:
    """Matte, glossy, close to a mirror, and two mirror images of each other; precomputed on first use."""
    functions = {"matte": lambert(*ALBEDO), "swirl": swirl(1), "counter": swirl(-1)}
    functions |= {name: TINY_MATERIALS[name] for name in ("satin-0.35", "copper-0.08")}
    with computed_on(HALF_GRID):
        yield MaterialLibrary.from_tables([MerlTable.from_function(f_r, name) for name, f_r in functions.items()])


def harmonic(library: MaterialLibrary, probe: LightProbe, view: View = SPHERE) -> BasisImages:
    return render_basis(library, probe, view, backend="harmonic")


def sampled(
    library: MaterialLibrary, probe: LightProbe, view: View = SPHERE, samples: int = 8192
) -> BasisImages:
    return render_basis(library, probe, view, backend="sampled", samples=samples)


def errors(found: BasisImages, expected: BasisImages) -> dict[str, float]:
    """The largest relative RMS error of the three columns of each material."""
    return {
        name: max(relative(found.packed[3 * i + c], expected.packed[3 * i + c]) for c in range(3))
        for i, name in enumerate(found.names)
    }


def pixel_means(view: View, value_of: Callable[[Tensor], Tensor]) -> Tensor:
    """(P,) means over the pixels of a function of the normals (3, P, S)."""
    u = (torch.arange(10) + 0.5) / 10
    grid = torch.cartesian_prod(u, u).T[:, None].expand(2, len(view.pixels), 100)
    return value_of(view.surface(view.pixels, *grid).normals).mean(1)


def waves() -> NormalMapView:
    """No sphere: hills and valleys of slopes up to 45 degrees."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, 12), torch.linspace(-1, 1, 12), indexing="ij")
    slopes = [-torch.sin(3 * x) * torch.cos(y), 0.7 * torch.cos(2 * y + x), torch.ones_like(x)]
    return NormalMapView(torch.stack(slopes))


def turn(*degrees: float) -> Tensor:
    return torch.from_numpy(Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()).float()


def lamp_at(*direction: float, width: float = 0.15) -> LightProbe:
    towards = normalize(torch.tensor(direction), dim=0)
    return probe_of(lambda d: torch.where(d @ towards > math.cos(width), 50.0, 0.01))


class TestClosedForms:
    def test_uniform_light_shows_the_albedo(self, library: MaterialLibrary) -> None:
        basis = harmonic(library.subset(["matte"]), LightProbe(torch.ones(3, 32, 64)))
        expected = torch.tensor(ALBEDO)[:, None, None].expand_as(basis.packed)
        assert relative(basis.packed, expected) < 1e-3
        assert float((basis.packed / expected - 1).abs().max()) < 2e-3

    @pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.48, -0.6, 0.64)])
    def test_linear_light(self, library: MaterialLibrary, axis: tuple[float, ...]) -> None:
        """[RH01]: a cosine lobe keeps 2 / 3 of the linear harmonics."""
        direction = torch.tensor(axis)
        basis = harmonic(library.subset(["matte"]), probe_of(lambda d: 1 + d @ direction))
        expected = pixel_means(SPHERE, lambda n: 1 + 2 / 3 * torch.einsum("kqs,k->qs", n, direction))
        for channel in range(3):
            assert relative(basis.packed[channel], (ALBEDO[channel] * expected).expand(3, -1)) < 1e-3

    def test_a_colour_of_the_light_stays_in_its_channel(self, library: MaterialLibrary) -> None:
        radiance = torch.zeros(3, 32, 64)
        radiance[1] = 2.0
        packed = harmonic(library, LightProbe(radiance)).packed
        assert float(packed[:, [0, 2]].abs().max()) < 1e-6
        assert float(packed[0, 1].mean()) == pytest.approx(2 * ALBEDO[0], rel=1e-3)


class TestOracle:
    """Against the sampled transport, whose own error with these samples is 0.05 to 0.2 %, 0.5 % under noise."""

    def test_two_lamps(self, library: MaterialLibrary) -> None:
        probe = lamps(64)
        found = errors(harmonic(library, probe), sampled(library, probe))
        assert max(found.values()) < 5e-3, found

    @pytest.mark.parametrize(("height", "tolerance"), [(2, 1e-2), (8, 5e-3), (32, 5e-3)])
    def test_coarse_noise(self, library: MaterialLibrary, height: int, tolerance: float) -> None:
        """Every texel of a pole in another colour, which bilinear radiance shows up to the next row."""
        generator = torch.Generator().manual_seed(height)
        probe = LightProbe(torch.rand(3, height, 2 * height, generator=generator) ** 4)
        found = errors(harmonic(library, probe), sampled(library, probe, samples=16384))
        assert max(found.values()) < tolerance, found

    @pytest.mark.parametrize("height", [2, 8])
    def test_coarse_probes(self, library: MaterialLibrary, height: int) -> None:
        """Each pole in one colour, as the sky and the ground have."""
        radiance = torch.rand(3, height, 2 * height, generator=torch.Generator().manual_seed(height)) ** 4
        radiance[:, 0], radiance[:, -1] = 1.0, torch.tensor([0.1, 0.2, 0.05])[:, None]
        found, expected = (render(library, LightProbe(radiance)) for render in (harmonic, sampled))
        assert max(errors(found, expected).values()) < 1e-2

    def test_normal_map_of_another_shape(self, library: MaterialLibrary) -> None:
        found = errors(harmonic(library, lamps(64), waves()), sampled(library, lamps(64), waves()))
        assert max(found.values()) < 5e-3, found

    def test_sign_of_the_odd_part(self, library: MaterialLibrary) -> None:
        """The image of one swirl is far from that of its mirror image, and agrees with its own."""
        probe = lamp_at(0.8, 0.3, 0.5)
        found, expected = (render(library, probe).subset(["swirl", "counter"]) for render in (harmonic, sampled))
        assert relative(found.packed[:3], found.packed[3:]) > 0.1
        assert max(errors(found, expected).values()) < 5e-3

    def test_mirrored_light_and_mirrored_material(self, library: MaterialLibrary) -> None:
        """Image and light mirrored at the plane x = 0 show the swirl the other way round."""
        one, other = lamp_at(0.8, 0.3, 0.5), lamp_at(-0.8, 0.3, 0.5)
        image, mirrored = harmonic(library, one).image("swirl"), harmonic(library, other).image("counter")
        assert relative(mirrored.flip(-1), image) < 2e-3


class TestOrientation:
    @pytest.mark.parametrize("material", ["matte", "copper-0.08"])
    @pytest.mark.parametrize("towards", [(1, 0), (-1, 0), (0, 1), (0, -1)])
    def test_lamp_appears_on_its_side(self, library: MaterialLibrary, material: str, towards: tuple[int, int]) -> None:
        """Image right is +X, top is +Y."""
        image = harmonic(library, lamp_at(*towards, 1.0)).image(material).mean(0).double()
        across = (torch.arange(16) + 0.5) / 8 - 1
        centre = torch.stack([(image.sum(0) * across).sum(), -(image.sum(1) * across).sum()]) / image.sum()
        assert float(centre @ torch.tensor(towards).double()) > 0.2
        assert abs(float(centre @ torch.tensor([towards[1], towards[0]]).double())) < 0.01

    def test_highlight_stands_half_way(self, library: MaterialLibrary) -> None:
        view = SphereView(24)
        image = harmonic(library, lamp_at(0.6, 0.48, 0.64), view).image("copper-0.08")[0]
        half = normalize(torch.tensor([0.6, 0.48, 1.64]), dim=0)
        row, column = divmod(int(image.argmax()), 24)
        assert abs((column + 0.5) / 12 - 1 - float(half[0])) < 1 / 12
        assert abs(1 - (row + 0.5) / 12 - float(half[1])) < 1 / 12

    def test_light_from_behind_lights_the_rim_only(self, library: MaterialLibrary) -> None:
        probe = probe_of(lambda d: torch.where(d[..., 2] < -0.9, 1.0, 0.0))
        image = harmonic(library, probe).image("matte")[0]
        assert float(image[5:11, 5:11].abs().max()) < 2e-3 * float(image.max())


class TestColumns:
    def test_selected_columns_are_rows_of_the_whole(self, library: MaterialLibrary) -> None:
        whole = harmonic(library, lamps())
        for part in (library.without("swirl"), library.subset(["copper-0.08", "matte"])):
            basis = harmonic(part, lamps())
            assert basis.names == part.names
            expected = whole.subset(part.names).packed
            torch.testing.assert_close(basis.packed, expected, rtol=1e-5, atol=1e-5 * float(expected.max()))

    def test_reordered(self, library: MaterialLibrary) -> None:
        """All columns, but not in the order in which they are stored."""
        names = library.names[::-1]
        basis, whole = harmonic(library.subset(names), lamps()), harmonic(library, lamps())
        expected = whole.subset(names).packed
        torch.testing.assert_close(basis.packed, expected, rtol=1e-5, atol=1e-5 * float(expected.max()))

    def test_says_where_it_comes_from(self, library: MaterialLibrary) -> None:
        basis = harmonic(library, lamps())
        assert basis.description == "harmonic"
        assert (basis.library, basis.probe, basis.view) == (library.source, lamps().fingerprint, SPHERE.fingerprint)


class TestExposure:
    @pytest.mark.parametrize("exponent", [-40, -20, 20, 40])
    def test_scaling_the_probe(self, library: MaterialLibrary, exponent: int) -> None:
        reference = harmonic(library, lamps()).packed
        scaled = harmonic(library, lamps().scaled(2.0**exponent)).packed
        torch.testing.assert_close(scaled / 2.0**exponent, reference, rtol=1e-5, atol=1e-5 * float(reference.max()))

    def test_sum_of_two_probes(self, library: MaterialLibrary) -> None:
        one, other = lamps(), probe_of(lambda d: 1 + d[..., 2], 32)
        total = harmonic(library, one).packed + 2 * harmonic(library, other).packed
        both = harmonic(library, LightProbe(one.radiance + 2 * other.radiance)).packed
        assert relative(both, total) < 1e-5


class TestTurning:
    @pytest.mark.parametrize("degrees", [(0, 0, 37), (25, -70, 110), (180, 0, 0)])
    def test_as_the_turned_probe_sampled(self, library: MaterialLibrary, degrees: tuple[float, ...]) -> None:
        """`rotated` resamples the probe; light without edges loses little by that."""
        probe = probe_of(lambda d: 0.2 + 3 * torch.exp(12 * (d @ normalize(torch.tensor([0.4, 0.5, 0.75]), dim=0) - 1)))
        rotation = turn(*degrees)
        turned = HarmonicBasis(library, probe, SPHERE).basis_at(rotation)
        found = errors(turned, sampled(library, probe.rotated(rotation)))
        assert max(found.values()) < 5e-3, found

    @pytest.mark.parametrize("degrees", [0.0, 30.0, -123.4])
    def test_about_the_view_axis_equals_the_general_path(self, library: MaterialLibrary, degrees: float) -> None:
        basis, rotation = HarmonicBasis(library, lamps(64), SPHERE), turn(0, 0, degrees)
        general = basis.basis_at(rotation.clone().requires_grad_())
        assert relative(basis.basis_at(rotation).packed, general.packed.detach()) < 3e-3

    def test_quarter_turn_turns_the_image(self, library: MaterialLibrary) -> None:
        basis = HarmonicBasis(library, lamps(64), SPHERE)
        image, turned = (basis.basis_at(rotation) for rotation in (None, turn(0, 0, 90)))
        expected = SPHERE.pack(torch.rot90(SPHERE.unpack(image.packed), 1, (-2, -1)))
        assert relative(turned.packed, expected) < 1e-4
        assert relative(turned.packed, image.packed) > 0.1

    def test_turned_images_are_of_no_probe_in_particular(self, library: MaterialLibrary) -> None:
        basis = HarmonicBasis(library, lamps(), SPHERE)
        names = {basis.basis_at(rotation).probe for rotation in (None, turn(0, 0, 0), turn(0, 0, 1), turn(1, 0, 0))}
        assert len(names) == 4
        assert basis.basis_at().probe == lamps().fingerprint


class TestGradients:
    def test_of_the_radiance(self, library: MaterialLibrary) -> None:
        generator = torch.Generator().manual_seed(0)
        weights = torch.randn(library.n, 3, len(SPHERE.pixels), generator=generator)
        direction = torch.rand(3, 32, 64, generator=generator)
        radiance = lamps().radiance.clone().requires_grad_()
        (harmonic(library, LightProbe(radiance)).packed * weights).sum().backward()
        assert radiance.grad is not None
        images = (harmonic(library, LightProbe(lamps().radiance + step * direction)).packed for step in (0.0, 8.0))
        before, after = ((image.double() * weights).sum() for image in images)
        assert float((radiance.grad * direction).sum()) == pytest.approx(float(after - before) / 8, rel=2e-3)

    def test_of_one_texel(self, library: MaterialLibrary) -> None:
        """The gradient of one pixel tells what a single texel adds."""
        radiance = torch.full((3, 8, 16), 0.5).requires_grad_()
        pixel, column = 120, 3 * library.names.index("copper-0.08")
        harmonic(library, LightProbe(radiance)).packed[column, 1, pixel].backward()
        assert radiance.grad is not None
        assert float(radiance.grad[[0, 2]].abs().max()) == 0
        brightest = int(radiance.grad[1].argmax())
        brighter = radiance.detach().clone()
        brighter[1].view(-1)[brightest] += 1
        images = [harmonic(library, LightProbe(r)).packed[column, 1, pixel] for r in (radiance.detach(), brighter)]
        assert float(images[1] - images[0]) == pytest.approx(float(radiance.grad[1].max()), rel=1e-3)

    def test_of_the_rotation(self, library: MaterialLibrary) -> None:
        """A turn by a small angle, against differences of two turns."""
        probe = probe_of(lambda d: 1 + 0.7 * d[..., 0] + 0.4 * d[..., 1] * d[..., 2])
        basis = HarmonicBasis(library.subset(["matte"]), probe, SPHERE)
        weights = torch.randn(3, 3, len(SPHERE.pixels), generator=torch.Generator().manual_seed(2))
        angle = torch.tensor(0.3, requires_grad=True)

        def tilted(a: Tensor) -> Tensor:
            zero, one = torch.zeros_like(a), torch.ones_like(a)
            rows = [[one, zero, zero], [zero, a.cos(), -a.sin()], [zero, a.sin(), a.cos()]]
            return torch.stack([torch.stack(row) for row in rows])

        (basis.basis_at(tilted(angle)).packed * weights).sum().backward()
        sides = [(basis.basis_at(tilted(torch.tensor(a))).packed.double() * weights).sum() for a in (0.25, 0.35)]
        assert float(angle.grad) == pytest.approx(float(sides[1] - sides[0]) / 0.1, rel=0.01)


def random_weights(library: MaterialLibrary) -> Tensor:
    return torch.randn(library.n, 3, generator=torch.Generator().manual_seed(7))


def combined(basis: BasisImages, weights: Tensor) -> Tensor:
    """(3, P): Y w, each channel with its own weights."""
    return torch.einsum("nc,ncp->cp", weights, basis.packed)


class TestBlends:
    """Combinations of columns that are made before there are pixels."""

    @pytest.mark.parametrize("names", [None, ["copper-0.08", "matte"], ["swirl", "counter", "copper-0.08", "matte"]])
    @pytest.mark.parametrize("degrees", [None, (0.0, 0.0, 37.0), (25.0, -70.0, 110.0)])
    def test_image_at(
        self, library: MaterialLibrary, names: list[str] | None, degrees: tuple[float, ...] | None
    ) -> None:
        """All columns, some of them, some in another order; as it is, about the view axis, about any."""
        some = library if names is None else library.subset(names)
        basis, rotation = HarmonicBasis(some, lamps(64), SPHERE), None if degrees is None else turn(*degrees)
        weights = random_weights(some)
        expected = combined(basis.basis_at(rotation), weights)
        found = basis.image_at(weights, rotation)
        assert found.shape == (3, len(SPHERE.pixels))
        assert relative(found, expected) < 1e-5
        assert relative(basis.image_at(weights.double(), rotation), expected) < 1e-5

    def test_image_at_of_another_shape(self, library: MaterialLibrary) -> None:
        basis, weights = HarmonicBasis(library, lamps(64), waves()), random_weights(library)
        assert relative(basis.image_at(weights), combined(basis.basis_at(), weights)) < 1e-5

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"weights": torch.ones(15)}, r"weights must be \(n, 3\) = \(15, 3\), a column for .*, got \(15,\)"),
            ({"weights": torch.ones(14, 3)}, r"weights must be \(n, 3\) = \(15, 3\), .*, got \(14, 3\)"),
            ({"rotation": torch.eye(2)}, r"rotation must be \(3, 3\), got \(2, 2\)"),
            ({"rotation": 2 * torch.eye(3)}, r"rotation must be orthonormal with .*, got determinant 8 and [^\n]*"),
        ],
    )
    def test_other_weights_and_rotations(
        self, library: MaterialLibrary, change: dict[str, Tensor], message: str
    ) -> None:
        basis = HarmonicBasis(library, lamps(), SPHERE)
        for render in (basis.image_at, basis.change_at):
            with pytest.raises(ValueError, match=f"^{message}$") as caught:
                render(**{"weights": torch.ones(15, 3), "rotation": torch.eye(3), **change})
            assert "\n" not in str(caught.value)

    def test_blended(self, library: MaterialLibrary) -> None:
        """Any number of combinations, each under all channels of the light."""
        basis = HarmonicBasis(library, lamps(64), waves())
        for count in (1, 5):
            weights = torch.randn(library.n, count, generator=torch.Generator().manual_seed(count))
            found = basis.transport.blended(basis._light.harmonics(), basis.view, weights)
            expected = torch.einsum("nk,ncp->kcp", weights, basis.basis_at().packed)
            assert found.shape == expected.shape
            assert relative(found, expected) < 1e-5

    def test_coloured(self, library: MaterialLibrary) -> None:
        """Each combination in its own channel of the light."""
        basis, weights = HarmonicBasis(library, lamps(64), waves()), random_weights(library)
        light = basis._light.harmonics()
        found = basis.transport.coloured(light, basis.view, weights)[0]
        expected = torch.diagonal(basis.transport.blended(light, basis.view, weights)).T
        assert relative(found, expected) < 1e-5

    @pytest.mark.parametrize("columns", [[1, 5, 6], [*range(15), *range(15)]])
    def test_some_columns(self, library: MaterialLibrary, columns: list[int]) -> None:
        """Few are mixed before they are seen, more after that; a basis may hold no others."""
        basis = HarmonicBasis(library, lamps(64), SPHERE)
        expected = basis.basis_at().packed[columns]
        assert relative(basis.packed_at(None, columns), expected) < 1e-5
        assert relative(HarmonicBasis(library, lamps(64), SPHERE, columns=columns).packed_at(None), expected) < 1e-5

    @pytest.mark.parametrize("columns", [[1, 4, 9], None])
    def test_many_rotations(self, library: MaterialLibrary, columns: list[int] | None, monkeypatch: pytest.MonkeyPatch):
        """More than share a pass, and with as many columns as are never shared."""
        if columns is None:
            monkeypatch.setattr("torchbrdf.transport.harmonic.basis._FEW", 3)
        basis = HarmonicBasis(library, lamps(64), SPHERE, columns=columns)
        turns = Rotation.from_rotvec([[0.1 * k, 0.3 * k, -0.2] for k in range(10)]).as_matrix()
        rotations = list(torch.tensor(turns))
        found = basis.packed_at_each(rotations)
        assert len(found) == 10
        for rotation, packed in zip(rotations, found, strict=True):
            assert relative(packed, basis.packed_at(rotation)) < 1e-5

    def test_rings_that_a_lamp_does_not_reach(
        self, library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Are left out, and nothing is missed."""
        radiance = torch.zeros(3, 64, 128)
        radiance[:, 20:22, 70:72] = 100
        basis = HarmonicBasis(library, LightProbe(radiance), SPHERE)
        found, seen = basis.basis_at().packed, []
        sees = Kernels.sees
        monkeypatch.setattr(Kernels, "sees", lambda group, lit: seen.append(sees(group, lit)) or True)
        assert relative(found, basis.basis_at().packed) < 1e-4
        assert not all(seen)

    def test_short_and_long_series(self, library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch) -> None:
        """Are the same along the rings, by one product or by four."""
        basis = HarmonicBasis(library, lamps(64), SPHERE)
        by_one, by_four = [], []
        for brief, found in ((10**9, by_one), (0, by_four)):
            monkeypatch.setattr("torchbrdf.transport.harmonic.transport._BRIEF", brief)
            found.append(basis.basis_at().packed)
        assert relative(by_one[0], by_four[0]) < 1e-5

    def test_gradient_of_the_weights(self, library: MaterialLibrary) -> None:
        """Of all columns and of some: what each adds to the image."""
        for some in (library, library.without("swirl")):
            basis, rotation = HarmonicBasis(some, lamps(64), SPHERE), turn(25, -70, 110)
            weights = random_weights(some).requires_grad_()
            field = torch.randn(3, len(SPHERE.pixels), generator=torch.Generator().manual_seed(8))
            (basis.image_at(weights, rotation) * field).sum().backward()
            assert weights.grad is not None
            expected = torch.einsum("ncp,cp->nc", basis.basis_at(rotation).packed, field)
            assert relative(weights.grad, expected) < 1e-4


class TestChanges:
    """How an image changes as the light turns on, after what has turned it already."""

    SMOOTH = probe_of(lambda d: 1 + 0.7 * d[..., 0] + 0.4 * d[..., 1] * d[..., 2] - 0.3 * d[..., 1])
    AFTER = turn(25.0, -70.0, 110.0)

    def turned_on(self, axis: int, degrees: float) -> Tensor:
        angles = [0.0, 0.0, 0.0]
        angles[axis] = degrees
        return turn(*angles) @ self.AFTER

    @pytest.mark.parametrize("names", [None, ["copper-0.08", "matte"]])
    def test_as_differences(self, library: MaterialLibrary, names: list[str] | None) -> None:
        """Per radian about +X, +Y and +Z, against two whole images."""
        some = library if names is None else library.subset(names)
        basis, weights = HarmonicBasis(some, self.SMOOTH, SPHERE), random_weights(some)
        found = basis.change_at(weights, self.AFTER)
        assert found.shape == (3, 3, len(SPHERE.pixels))
        for axis in range(3):
            after, before = (basis.image_at(weights, self.turned_on(axis, degrees)) for degrees in (2, -2))
            assert relative(found[axis], (after - before) / math.radians(4)) < 0.01

    def test_under_lamps(self, library: MaterialLibrary) -> None:
        """Edges of light on a material close to a mirror: over as small a turn as `change_at` takes itself."""
        basis = HarmonicBasis(library, lamps(64), SPHERE)
        weights = torch.zeros(library.n, 3)
        weights[3 * library.names.index("copper-0.08") :][:3] = torch.eye(3)
        found = basis.change_at(weights, self.AFTER.double())
        for axis in range(3):
            after, before = (basis.image_at(weights, self.turned_on(axis, degrees)) for degrees in (0.2, -0.2))
            assert relative(found[axis], (after - before) / math.radians(0.4)) < 0.03

    def test_as_gradients(self, library: MaterialLibrary) -> None:
        """Against automatic differentiation of a turn by a vector."""
        basis, weights = HarmonicBasis(library, self.SMOOTH, SPHERE), random_weights(library)
        field = torch.randn(3, len(SPHERE.pixels), generator=torch.Generator().manual_seed(9))
        vector = torch.zeros(3, requires_grad=True)
        zero = torch.zeros(())
        x, y, z = vector
        generator = torch.stack([torch.stack(row) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])])
        rotation = (torch.eye(3) + generator) @ self.AFTER
        (basis.image_at(weights, rotation) * field).sum().backward()
        found = (basis.change_at(weights, self.AFTER) * field).sum((1, 2))
        assert vector.grad is not None
        assert float((found - vector.grad).norm()) < 0.02 * float(vector.grad.norm())

    def test_uniform_light_never_changes(self, library: MaterialLibrary) -> None:
        basis, weights = HarmonicBasis(library, LightProbe(torch.ones(3, 8, 16)), SPHERE), random_weights(library)
        image = basis.image_at(weights)
        assert float(basis.change_at(weights, self.AFTER).abs().max()) < 1e-3 * float(image.abs().max())

    def test_a_turn_about_the_view_turns_the_image(self, library: MaterialLibrary) -> None:
        """Light that the right half shows wanders up: the image grows on top, shrinks below."""
        probe = probe_of(lambda d: 1 + d[..., 0])
        basis, weights = HarmonicBasis(library, probe, SPHERE), torch.zeros(library.n, 3)
        weights[:3] = torch.eye(3)
        about_z = SPHERE.unpack(basis.change_at(weights, torch.eye(3))[2])
        slope = torch.tensor(ALBEDO)[:, None, None] * 2 / 3
        height = 1 - (torch.arange(16) + 0.5)[:, None] / 8
        inside = SPHERE.mask.expand(3, -1, -1)
        torch.testing.assert_close(about_z[inside], (slope * height).expand(3, 16, 16)[inside], rtol=0, atol=0.01)


class Tilted(SphereView):
    """A camera that looks along another axis."""

    def surface(self, pixels: Tensor, u: Tensor, v: Tensor) -> SurfacePoints:
        points = super().surface(pixels, u, v)
        return SurfacePoints(points.normals, points.view_dirs.roll(1, 0))


class SelfShading(SphereView):
    def visibility(self, points: SurfacePoints, w_i: Tensor) -> Tensor | None:
        return (points.normals * w_i).sum(0) > 0


class TestViews:
    def test_some_pixels_as_in_the_whole(self, library: MaterialLibrary) -> None:
        """Where the neighbours are kept, too, the normals inside a pixel are the same."""
        shape = waves()
        kept = torch.zeros_like(shape.mask)
        kept[:, 2:9, 1:11] = True
        inner = torch.zeros_like(kept)
        inner[:, 3:8, 2:10] = True
        whole = harmonic(library, lamps(), shape)
        part = harmonic(library, lamps(), NormalMapView(shape.normals, kept))
        assert part.packed.shape[-1] == int(kept.sum())
        expected = whole.unpack(whole.packed)[..., inner[0]]
        found = part.unpack(part.packed)[..., inner[0]]
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5 * float(expected.max()))

    def test_one_pixel(self, library: MaterialLibrary) -> None:
        """A single normal, towards the camera: no neighbours, no slopes."""
        view = NormalMapView(torch.tensor([0.0, 0.0, 1.0])[:, None, None])
        basis = harmonic(library.subset(["matte"]), probe_of(lambda d: 1 + d[..., 2]), view)
        assert float(basis.packed[0, 0]) == pytest.approx(ALBEDO[0] * 5 / 3, rel=1e-3)

    def test_normals_at_the_silhouette(self, library: MaterialLibrary) -> None:
        view = NormalMapView(torch.tensor([1.0, 0.0, 1e-3])[:, None, None])
        basis = harmonic(library.subset(["matte"]), probe_of(lambda d: 1 + d[..., 0]), view)
        assert float(basis.packed[0, 0]) == pytest.approx(ALBEDO[0] * 5 / 3, rel=3e-3)

    @pytest.mark.parametrize(
        ("view", "reason"), [(Tilted(12), "is not orthographic"), (SelfShading(12), "may shade itself")]
    )
    def test_other_views(self, library: MaterialLibrary, view: View, reason: str) -> None:
        with pytest.raises(ValueError, match=reason) as caught:
            HarmonicBasis(library, lamps(), view)
        assert "\n" not in str(caught.value)
        assert str(caught.value).endswith('; use backend="sampled"')

    def test_normal_map_in_perspective(self, library: MaterialLibrary) -> None:
        sphere = SphereView(12, fov_deg=30)
        with pytest.raises(ValueError, match="not orthographic"):
            harmonic(library, lamps(), NormalMapView(sphere.normals, sphere.mask, sphere.view_dirs))


def test_several_pictures_are_those_of_their_weights(library: MaterialLibrary) -> None:
    weights = torch.rand(2, library.n, 3, generator=torch.Generator().manual_seed(0))
    basis = HarmonicBasis(library, lamps(64), SPHERE)
    expected = torch.stack([SPHERE.unpack(basis.image_at(each)) for each in weights])
    assert relative(basis.images_of(weights), expected) < 2e-3


def test_several_pictures_of_some_materials(library: MaterialLibrary) -> None:
    some = library.subset(["swirl", "matte"])
    weights = torch.rand(1, some.n, 3, generator=torch.Generator().manual_seed(0))
    basis = HarmonicBasis(some, lamps(64), SPHERE)
    assert relative(basis.images_of(weights)[0], SPHERE.unpack(basis.image_at(weights[0]))) < 2e-3


def test_copies_share_the_transport_and_pickles_open_it(library: MaterialLibrary) -> None:
    basis = HarmonicBasis(library, probe_of(lambda d: 1 + d[..., 1]), SPHERE)
    weights = torch.ones(basis.n, 3)
    image = basis.image_at(weights)
    copied, found = copy.deepcopy(basis), pickle.loads(pickle.dumps(basis))
    assert copied.transport is basis.transport
    for one in (copied, found):
        torch.testing.assert_close(one.image_at(weights), image)


class TestWhatUsersGive:
    PROBE = probe_of(lambda d: 1 + d[..., 1])

    def test_rotations_are_arrays_or_tensors(self, library: MaterialLibrary) -> None:
        basis, rotation = HarmonicBasis(library, self.PROBE, SPHERE), turn(10, 20, 30)
        weights = torch.ones(basis.n, 3)
        for call in (basis.image_at, basis.change_at):
            assert torch.equal(call(weights, rotation.numpy()), call(weights, rotation))
        assert torch.equal(basis.basis_at(rotation.numpy()).packed, basis.basis_at(rotation).packed)

    def test_some_columns_have_no_basis_images(self, library: MaterialLibrary) -> None:
        basis = HarmonicBasis(library, self.PROBE, SPHERE, columns=[0, 1, 2])
        with pytest.raises(ValueError, match=r"^this HarmonicBasis is of some columns, .*; use image_at$"):
            basis.basis_at()
        assert basis.image_at(torch.eye(3)).shape[0] == 3

    @pytest.mark.parametrize("shape", [(15, 3), (0, 15, 3), (2, 14, 3), (2, 15, 1), (1, 2, 15, 3)])
    def test_weights_of_no_images(self, library: MaterialLibrary, shape: tuple[int, ...]) -> None:
        basis = HarmonicBasis(library, self.PROBE, SPHERE)
        with pytest.raises(ValueError, match=r"^weights must be \(K, n, 3\) = \(K, 15, 3\) of at least one"):
            basis.images_of(torch.ones(shape))
