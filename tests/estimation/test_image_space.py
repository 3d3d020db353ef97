import math

import pytest
import torch
from torch import Tensor

from torchbrdf.estimation.image_space import CUT, DARKEST, ImageSpace, UnformedSpace

PIXELS = 60


def images(n: int = 9, pixels: int = PIXELS, seed: int = 0) -> Tensor:
    """Basis images (n, 3, P) float32, each pixel with a brightness of its own."""
    g = torch.Generator().manual_seed(seed)
    brightness = 10 ** (2 * torch.rand(1, 3, pixels, generator=g) - 1)
    return brightness * (0.1 + torch.rand(n, 3, pixels, generator=g))


def scale_of(packed: Tensor) -> Tensor:
    """m + 0.3 mean(m) of one photograph, written out."""
    mean = packed.double().mean(0)
    return mean + 0.3 * mean.mean(-1, keepdim=True)


def columns(space: ImageSpace) -> Tensor:
    """U R, (3, P, n)."""
    return space.u @ space.r


def gap(space: ImageSpace) -> float:
    """How far the columns of U are from orthonormal; columns of zeros, of a channel without light, are left out."""
    gram = space.u.mT @ space.u
    lit = torch.diag_embed((space.u != 0).any(1).double())
    return float((gram - lit).abs().max())


def used_pixels(share: float, pixels: int = PIXELS, seed: int = 4) -> Tensor:
    order = torch.randperm(pixels, generator=torch.Generator().manual_seed(seed))
    used = torch.zeros(pixels, dtype=torch.bool)
    used[order[: max(1, round(share * pixels))]] = True
    return used


class TestFactors:
    def test_orthonormal(self):
        space = ImageSpace.of(images(), [PIXELS])
        assert space.u.dtype == torch.float64
        assert space.scale.dtype == space.r.dtype == torch.float64
        assert space.u.shape == (3, PIXELS, 9)
        assert space.r.shape == (3, 9, 9)
        assert gap(space) < 1e-6

    def test_reproduces_the_weighted_images(self):
        packed = images()
        space = ImageSpace.of(packed, [PIXELS])
        expected = packed.double().permute(1, 2, 0) / scale_of(packed)[..., None]
        assert float((columns(space) - expected).abs().max()) < 1e-6 * float(expected.abs().max())

    def test_scale_is_the_mean_image_and_three_tenths_of_its_mean(self):
        packed = images()
        space = ImageSpace.of(packed, [PIXELS])
        assert DARKEST == 0.3
        assert torch.allclose(space.scale, scale_of(packed), rtol=1e-14)

    def test_every_photograph_has_its_own_mean(self):
        """A second photograph, a hundred times brighter, does not raise what is added to the first."""
        first, second = images(pixels=25), 100 * images(pixels=35, seed=1)
        both = ImageSpace.of(torch.cat([first, second], -1), [25, 35])
        assert torch.allclose(both.scale, torch.cat([scale_of(first), scale_of(second)], -1), rtol=1e-12)
        as_one = ImageSpace.of(torch.cat([first, second], -1), [60])
        assert float((as_one.scale[:, :25] / both.scale[:, :25]).min()) > 3

    @pytest.mark.parametrize("power", [-30, -7, 20])
    def test_residual_weights_are_without_scale(self, power: int):
        packed = images()
        one, other = ImageSpace.of(packed, [PIXELS]), ImageSpace.of(packed * 2.0**power, [PIXELS])
        assert torch.equal(other.scale, one.scale * 2.0**power)
        assert torch.equal(other.u, one.u)
        assert torch.equal(other.r, one.r)

    def test_energy_is_that_of_the_weighted_images(self):
        packed = images()
        expected = (packed.double() / scale_of(packed)).square().sum(-1).mT
        assert torch.allclose(ImageSpace.of(packed, [PIXELS]).energy, expected, rtol=1e-8)

    def test_directions_below_the_cut_are_dropped(self):
        """Columns that differ from a common one by 1e-6 of it span only that; by 1e-3, more."""
        g = torch.Generator().manual_seed(2)
        common = images(1).double()
        change = torch.rand(6, 3, PIXELS, generator=g, dtype=torch.float64)
        for size, rank in [(0.02 * CUT, 1), (20 * CUT, 6)]:
            packed = common * (1 + size * change)
            space = ImageSpace.of(packed, [PIXELS])
            assert space.u.shape[-1] == rank
            expected = packed.permute(1, 2, 0) / scale_of(packed)[..., None]
            off = torch.linalg.matrix_norm(columns(space) - expected, ord=2)
            assert (off < 1.5 * CUT * torch.linalg.matrix_norm(expected, ord=2)).all()

    def test_duplicate_columns(self):
        packed = images(5)
        once, twice = ImageSpace.of(packed, [PIXELS]), ImageSpace.of(torch.cat([packed, packed]), [PIXELS])
        assert twice.u.shape == once.u.shape
        assert torch.allclose(twice.r[..., :5], twice.r[..., 5:], rtol=0, atol=1e-10)
        assert torch.allclose(columns(twice)[..., :5], columns(once), rtol=0, atol=1e-6)

    def test_a_channel_without_light(self):
        packed = images()
        lit = ImageSpace.of(packed, [PIXELS])
        packed[:, 1] = 0
        space = ImageSpace.of(packed, [PIXELS])
        assert float(space.scale[1].abs().max()) == float(space.r[1].abs().max()) == 0
        assert torch.isfinite(space.u).all()
        assert torch.equal(space.r[[0, 2]], lit.r[[0, 2]])
        coordinates, energy = space.project(packed[:2] + 0.5)
        assert float(coordinates[:, 1].abs().max()) == float(energy[:, 1].abs().max()) == 0
        assert float(energy[:, [0, 2]].min()) > 0
        assert float(space.render(torch.ones(1, 3, 9).double(), torch.float64)[:, 1].abs().max()) == 0

    def test_one_pixel(self):
        packed = images(4, 1)
        space = ImageSpace.of(packed, [1])
        assert space.u.shape == (3, 1, 1)
        assert torch.allclose(columns(space)[:, 0], packed[..., 0].double().mT / scale_of(packed), rtol=1e-6)

    def test_no_gradient_reaches_the_basis(self):
        space = ImageSpace.of(images().requires_grad_(), [PIXELS])
        assert not any(part.requires_grad for part in (space.scale, space.u, space.r))


class TestPhotographs:
    def test_render_is_the_combination(self):
        packed = images()
        g = torch.Generator().manual_seed(1)
        weights = torch.randn(2, 3, 9, generator=g, dtype=torch.float64)
        rendered = ImageSpace.of(packed, [PIXELS]).render(weights, torch.float64)
        expected = torch.einsum("nsp,bsn->bsp", packed.double(), weights)
        assert float((rendered - expected).abs().max()) < 1e-6 * float(expected.abs().max())

    def test_projection_of_a_combination_is_its_coordinates(self):
        """U^T of what lies in the space, and nothing is left outside."""
        packed = images()
        space = ImageSpace.of(packed, [PIXELS])
        w = torch.randn(2, 3, 9, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        coordinates, energy = space.project(torch.einsum("nsp,bsn->bsp", packed.double(), w))
        expected = torch.einsum("srn,bsn->bsr", space.r, w)
        assert coordinates.dtype == energy.dtype == torch.float64
        assert float((coordinates - expected).abs().max()) < 1e-6 * float(expected.abs().max())
        assert torch.allclose(energy, expected.square().sum(-1), rtol=1e-6)

    def test_what_lies_outside_the_space_has_energy_only(self):
        packed = images()
        space = ImageSpace.of(packed, [PIXELS])
        noise = torch.randn(3, PIXELS, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
        u = space.u
        outside = noise - (u @ (u.mT @ noise[..., None]))[..., 0]
        coordinates, energy = space.project((outside * space.scale)[None])
        assert float(coordinates.abs().max()) < 1e-5
        assert torch.allclose(energy[0], outside.square().sum(-1), rtol=1e-9)

    def test_float32_photographs_are_seen_in_float64(self):
        packed = images()
        space = ImageSpace.of(packed, [PIXELS])
        y = images(4, seed=7)
        low, high = space.project(y), space.project(y.double())
        assert torch.equal(low[0], high[0])
        assert torch.equal(low[1], high[1])
        weights = torch.ones(1, 3, 9, dtype=torch.float64)
        pair = [space.render(weights, dtype) for dtype in (torch.float32, torch.float64)]
        assert [image.dtype for image in pair] == [torch.float32, torch.float64]
        assert torch.allclose(pair[0].double(), pair[1], rtol=1e-5)

    def test_growth_of_the_squares_without_an_image(self):
        """|residual + Y change|^2 - |residual|^2, written out."""
        packed = images()
        space = ImageSpace.of(packed, [PIXELS])
        g = torch.Generator().manual_seed(6)
        residual = torch.randn(2, 3, PIXELS, generator=g, dtype=torch.float64)
        change = torch.randn(2, 4, 3, 9, generator=g, dtype=torch.float64)
        moved = residual[:, None] + torch.einsum("nsp,bksn->bksp", packed.double(), change)
        expected = moved.square().sum((-2, -1)) - residual.square().sum((-2, -1))[:, None]
        assert torch.allclose(space.growth(residual, change), expected, rtol=1e-5)
        assert torch.allclose(space.growth(residual.float(), change), expected, rtol=1e-4)


class TestMasked:
    @pytest.mark.parametrize("share", [0.97, 0.8, 0.5, 0.35, 0.2])
    def test_is_the_space_of_the_cropped_pixels(self, share: float):
        """With the scale of the whole view: same pixels, same R in other coordinates. Both ways to the Gram matrix."""
        packed, used = images(), used_pixels(share)
        whole = ImageSpace.of(packed, [PIXELS])
        space = whole.masked(used)
        weighted = packed[..., used].double() / whole.scale[:, used]
        assert torch.equal(space.scale, whole.scale[:, used])
        assert gap(space) < 1e-6
        assert torch.allclose(columns(space), weighted.permute(1, 2, 0), rtol=0, atol=1e-5)
        y = images(3, seed=9).double()[..., used]
        fitted = [one.u @ one.project(y)[0][..., None] for one in (space, reference(packed, whole, used))]
        assert torch.allclose(fitted[0], fitted[1], rtol=0, atol=1e-5)
        weights = torch.randn(2, 3, 9, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        assert torch.allclose(
            space.render(weights, torch.float64), whole.render(weights, torch.float64)[..., used], rtol=1e-5, atol=1e-5
        )

    def test_the_two_ways_agree(self, monkeypatch: pytest.MonkeyPatch):
        used = used_pixels(0.6)
        whole = ImageSpace.of(images(), [PIXELS])
        monkeypatch.setattr("torchbrdf.estimation.image_space._BRIEF", 0.0)
        summed = whole.masked(used)
        monkeypatch.setattr("torchbrdf.estimation.image_space._BRIEF", 1.0)
        reduced = whole.masked(used)
        assert torch.allclose(columns(summed), columns(reduced), rtol=0, atol=1e-5)
        assert torch.allclose(summed.r.mT @ summed.r, reduced.r.mT @ reduced.r, rtol=1e-5)
        assert not torch.equal(summed.r, reduced.r)

    def test_fewer_pixels_than_directions(self):
        used = used_pixels(0.08)  # 5 pixels of 60, 9 directions
        whole = ImageSpace.of(images(), [PIXELS])
        space = whole.masked(used)
        assert space.u.shape == (3, 5, 5)
        assert gap(space) < 1e-6
        assert torch.allclose(columns(space), columns(whole)[:, used], rtol=0, atol=1e-5)

    def test_one_pixel_left(self):
        used = used_pixels(0)
        whole = ImageSpace.of(images(), [PIXELS])
        space = whole.masked(used)
        assert space.u.shape == (3, 1, 1)
        assert torch.allclose(columns(space), columns(whole)[:, used], rtol=1e-5)

    def test_nothing_left_out_changes_nothing(self):
        whole = ImageSpace.of(images(), [PIXELS])
        space = whole.masked(torch.ones(PIXELS, dtype=torch.bool))
        assert torch.allclose(columns(space), columns(whole), rtol=0, atol=1e-6)
        assert math.isclose(float(space.energy.sum()), float(whole.energy.sum()), rel_tol=1e-6)

    def test_a_channel_without_light_under_a_mask(self):
        packed = images()
        packed[:, 2] = 0
        space = ImageSpace.of(packed, [PIXELS]).masked(used_pixels(0.7))
        assert torch.isfinite(space.u).all()
        assert torch.isfinite(space.r).all()
        assert float(space.r[2].abs().max()) == 0


def reference(packed: Tensor, whole: ImageSpace, used: Tensor) -> ImageSpace:
    """QR of the cropped, weighted basis images."""
    weighted = packed[..., used].double() / whole.scale[:, used]
    u, r = torch.linalg.qr(weighted.permute(1, 2, 0))
    return ImageSpace(whole.scale[:, used], u, r)


class TestUnformed:
    """Photographs seen through the basis images' own products."""

    @pytest.fixture
    def spaces(self) -> tuple[ImageSpace, UnformedSpace]:
        packed = images(30)
        return tuple(kind.weighted(packed, scale_of(packed)) for kind in (ImageSpace, UnformedSpace))

    def test_u_is_the_same(self, spaces: tuple[ImageSpace, UnformedSpace]) -> None:
        torch.testing.assert_close(spaces[1].u @ spaces[1].r, columns(spaces[0]), rtol=0, atol=1e-6)
        assert gap(spaces[1]) < 1e-6

    def test_photographs_have_the_same_coordinates(self, spaces: tuple[ImageSpace, UnformedSpace]) -> None:
        y = images(2, seed=5).double()
        formed, unformed = (space.project(y) for space in spaces)
        torch.testing.assert_close(unformed[0].square().sum(-1), formed[0].square().sum(-1))
        pairs = zip((formed, unformed), spaces, strict=True)
        towards = [(found[:, :, None] @ space.r)[:, :, 0] for (found, _), space in pairs]
        torch.testing.assert_close(towards[1], towards[0], rtol=0, atol=1e-6 * float(towards[0].abs().max()))
        torch.testing.assert_close(unformed[1], formed[1])

    def test_renders_the_same(self, spaces: tuple[ImageSpace, UnformedSpace]) -> None:
        weights = torch.randn(2, 3, 30, dtype=torch.float64, generator=torch.Generator().manual_seed(6))
        formed, unformed = (space.render(weights, torch.float64) for space in spaces)
        torch.testing.assert_close(unformed, formed, rtol=0, atol=1e-6 * float(formed.abs().max()))

    def test_first_directions(self, spaces: tuple[ImageSpace, UnformedSpace]) -> None:
        """The largest, with the coordinates of all."""
        y, first = images(1, seed=5).double(), spaces[1].first(7)
        assert torch.equal(first.r, spaces[1].r[:, :7])
        torch.testing.assert_close(first.project(y)[0], spaces[1].project(y)[0][..., :7])
        assert float(first.energy.sum()) > 0.9 * float(spaces[1].energy.sum())
