import copy
import re
import warnings
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import above_horizon
from torchbrdf.estimation.classes import MaterialClasses, Mixture
from torchbrdf.estimation.estimator import DEFAULT_PENALTY, BRDFEstimator
from torchbrdf.estimation.reconstruction import Reconstruction
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.rendering.tables import render
from torchbrdf.transport.basis_images import BasisImages
from torchbrdf.view.sphere import SphereView

HEIGHT, WIDTH = 7, 9
LABELS = (0, 0, 1, 1, 0, 2, 1, 2, 2, 0, 0, 1)
"""Classes of 5, 4 and 3 of the twelve basis BRDFs: none is a contiguous block."""

SOLVERS = ["factored", "lstsq"]
METHODS = {
    "auto": {},
    "fixed": {"penalty": 0.0005},
    "lstsq": {"penalty": 0.0005, "solver": "lstsq"},
    "robust": {"robust": True},
    "nonnegative": {"constraint": "nonnegative"},
}
"""Settings that must keep the properties of batches, masks and gradients."""


def classes_of(labels: tuple[int, ...] = LABELS, library: str = "L") -> MaterialClasses:
    """Classes with these labels; the Gaussians do not matter to the estimator."""
    responsibilities = torch.nn.functional.one_hot(torch.tensor(labels)).double()
    k = responsibilities.shape[1]
    mixture = Mixture(
        mixing=responsibilities.mean(0),
        means=torch.zeros(k, 4).double(),
        covariances=torch.eye(4).double().repeat(k, 1, 1),
        responsibilities=responsibilities,
        history=(0.0,),
        converged=True,
    )
    names = [f"m{i}" for i in range(len(labels) // 3)]
    return MaterialClasses(mixture, names, library)


def synthetic(n: int = 12, seed: int = 0, library: str = "L") -> BasisImages:
    """Well-conditioned random basis images over 40-odd of 63 pixels."""
    g = torch.Generator().manual_seed(seed)
    mask = torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(99)) < 0.7
    packed = torch.rand(n, 3, int(mask.sum()), generator=g)
    names = tuple(f"m{i}" for i in range(n // 3))
    return BasisImages(packed, mask, names, library, probe="P", view="V")


def planted(basis: BasisImages, weights: Tensor) -> Tensor:
    """The photograph (*batch, 3, H, W), float64, of weights (*batch, n, 3), by a loop over basis BRDFs."""
    total = torch.zeros(*weights.shape[:-2], 3, basis.packed.shape[-1], dtype=torch.float64)
    for i in range(basis.n):
        total += weights[..., i, :, None] * basis.packed[i].double()
    return basis.unpack(total)


def some_images(*batch: int, seed: int = 5) -> Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.rand(*batch, 3, HEIGHT, WIDTH, generator=g, dtype=torch.float64) + 0.1


def some_masks(*batch: int, seed: int = 8) -> Tensor:
    return torch.rand(*batch, 1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(seed)) < 0.7


def assert_same(a: Reconstruction, b: Reconstruction, rtol: float = 1e-9) -> None:
    assert torch.equal(a.class_index, b.class_index)
    for field in ("weights", "class_weights", "class_errors", "class_probabilities", "error", "energy", "image"):
        assert getattr(a, field).shape == getattr(b, field).shape, field
        assert torch.allclose(getattr(a, field), getattr(b, field), rtol=rtol, atol=1e-11), field


@pytest.fixture
def basis() -> BasisImages:
    return synthetic()


@pytest.fixture(scope="module")
def rendered(tiny_library: MaterialLibrary) -> tuple[BasisImages, LightProbe, SphereView]:
    probe, view = LightProbe.default(32), SphereView(16)
    return render_basis(tiny_library, probe, view, samples=512), probe, view


def settings_of(estimator: BRDFEstimator) -> dict:
    """To make another estimator like this one."""
    return {key: getattr(estimator, key) for key in ("penalty", "solver", "constraint", "robust")}


@pytest.fixture(params=["auto", "fixed", "lstsq"])
def estimator(request: pytest.FixtureRequest, basis: BasisImages) -> BRDFEstimator:
    return BRDFEstimator(basis, classes_of(), **METHODS[request.param])


@pytest.fixture(params=METHODS)
def any_estimator(request: pytest.FixtureRequest, basis: BasisImages) -> BRDFEstimator:
    return BRDFEstimator(basis, classes_of(), **METHODS[request.param])


@pytest.fixture(params=["fixed", "lstsq"])
def fixed(request: pytest.FixtureRequest, basis: BasisImages) -> BRDFEstimator:
    return BRDFEstimator(basis, classes_of(), **METHODS[request.param])


class TestMethod:
    @pytest.mark.parametrize("solver", SOLVERS)
    @pytest.mark.parametrize("penalty", ["paper", 0.07])
    def test_each_candidate_is_equation_26_written_out(self, basis: BasisImages, solver: str, penalty):
        """lambda_j = lambda |y|^2 / c_j of eq. 25, y one colour channel; prior 1 / c_j; selection over R, G and B."""
        image = some_images()
        result = BRDFEstimator(basis, classes_of(), penalty=penalty, solver=solver)(image)
        chosen = 0.5 if penalty == "paper" else penalty
        errors = []
        for j in range(3):
            members = [i for i, label in enumerate(LABELS) if label == j]
            c, error = len(members), 0.0
            for s in range(3):
                big_y = basis.packed[members, s].double().T
                y = image[s][basis.mask[0]]
                lambda_j = chosen * float((y * y).sum()) / c
                left = big_y.T @ big_y + lambda_j * torch.eye(c, dtype=torch.float64)
                right = big_y.T @ y + lambda_j * torch.full((c,), 1 / c, dtype=torch.float64)
                w = torch.linalg.solve(left, right)
                assert torch.allclose(result.class_weights[j, members, s], w, rtol=1e-9, atol=1e-12)
                error += float((big_y @ w - y).square().sum())
            others = [i for i in range(12) if i not in members]
            assert float(result.class_weights[j, others].abs().max()) == 0
            errors.append(error)
        assert result.class_errors.tolist() == pytest.approx(errors, rel=1e-9)
        assert int(result.class_index) == min(range(3), key=lambda j: errors[j])
        assert torch.equal(result.weights, result.class_weights[int(result.class_index)])

    def test_paper_means_one_half_and_the_default_is_the_stated_one(self, basis: BasisImages):
        image = some_images()
        by_name, by_number = (BRDFEstimator(basis, classes_of(), penalty=p)(image) for p in ("paper", 0.5))
        assert_same(by_name, by_number, rtol=0)
        stated = BRDFEstimator(basis, classes_of(), penalty=DEFAULT_PENALTY)
        assert_same(BRDFEstimator(basis, classes_of())(image), stated(image), rtol=0)

    def test_the_class_is_chosen_for_all_channels_together(self, basis: BasisImages):
        """Class 0 explains red and green, class 2 explains blue, which is brighter: the sum decides."""
        weights = torch.zeros(12, 3, dtype=torch.float64)
        weights[[0, 1, 4, 9, 10], :2] = 0.2
        weights[[5, 7, 8], 2] = 1.0
        estimator = BRDFEstimator(basis, classes_of(), penalty=0.0)
        result = estimator(planted(basis, weights))
        by_channel = torch.stack([
            (torch.einsum("knc,ncp->kcp", result.class_weights, basis.packed.double())
             - basis.pack(planted(basis, weights))).square().sum(-1)
        ])[0]  # fmt: skip
        assert by_channel.argmin(0).tolist() == [0, 0, 2]
        assert int(result.class_index) == int(by_channel.sum(1).argmin()) == 2
        dimmer = weights * torch.tensor([3.0, 3.0, 0.1])
        assert int(estimator(planted(basis, dimmer)).class_index) == 0

    @pytest.mark.parametrize("solver", SOLVERS)
    @pytest.mark.parametrize("j", [0, 1, 2])
    def test_planted_truth_comes_back(self, basis: BasisImages, solver: str, j: int):
        weights = torch.zeros(12, 3, dtype=torch.float64)
        members = torch.tensor(LABELS) == j
        g = torch.Generator().manual_seed(j)
        weights[members] = torch.randn(int(members.sum()), 3, generator=g, dtype=torch.float64)
        result = BRDFEstimator(basis, classes_of(), penalty=0.0, solver=solver)(planted(basis, weights))
        assert int(result.class_index) == j
        assert torch.allclose(result.weights, weights, atol=1e-7)
        assert float(result.relative_error) < 1e-7
        assert torch.allclose(result.image, planted(basis, weights), atol=1e-7)

    def test_the_mean_brdf_of_a_class_is_its_own_estimate(self, estimator: BRDFEstimator, basis: BasisImages):
        """y = Y mu': both terms are zero at w = mu', whatever the penalty; other priors are improbable."""
        weights = torch.zeros(12, 3, dtype=torch.float64)
        weights[torch.tensor(LABELS) == 1] = 1 / 4
        result = estimator(planted(basis, weights))
        assert int(result.class_index) == 1
        assert torch.allclose(result.class_weights[1], weights, atol=1e-10)
        assert torch.allclose(result.weights, weights, atol=1e-8)

    def test_fitted_image_energy_and_errors_belong_together(self, estimator: BRDFEstimator, basis: BasisImages):
        image = some_images(2)
        result = estimator(image)
        assert torch.allclose(result.image, planted(basis, result.weights), rtol=1e-6)
        y, fitted = basis.pack(image), basis.pack(result.image)
        assert torch.allclose(result.energy, y.square().sum((1, 2)))
        error = (fitted - y).square().sum((1, 2))
        assert torch.allclose(result.error, error, rtol=1e-9)
        assert torch.allclose(result.relative_error, (error / result.energy).sqrt(), rtol=1e-9)
        for j in range(3):
            candidate = basis.pack(planted(basis, result.class_weights[:, j]))
            assert torch.allclose(result.class_errors[:, j], (candidate - y).square().sum((1, 2)), rtol=1e-5)
        assert torch.equal(result.class_index, result.class_probabilities.argmax(1))
        assert torch.allclose(result.class_probabilities.sum(1), torch.ones(2).double())

    def test_a_fixed_penalty_keeps_the_class_of_smallest_error(self, fixed: BRDFEstimator):
        result = fixed(some_images(4))
        assert torch.equal(result.class_index, result.class_errors.argmin(1))
        assert torch.equal(result.class_probabilities.argmax(1), result.class_index)
        assert set(result.class_probabilities.unique().tolist()) == {0.0, 1.0}
        for i in range(4):
            assert torch.equal(result[i].weights, result.class_weights[i, int(result.class_index[i])])
            assert torch.equal(result.error[i], result.class_errors[i, int(result.class_index[i])])

    def test_auto_averages_classes_and_more(self, basis: BasisImages):
        """A photograph of one class: its probability is near 1, and yet others have a share in the weights."""
        weights = torch.zeros(12, 3, dtype=torch.float64)
        weights[torch.tensor(LABELS) == 0] = torch.tensor([0.5, 0.1, 0.2, 0.1, 0.1], dtype=torch.float64)[:, None]
        result = BRDFEstimator(basis, classes_of())(planted(basis, weights))
        assert float(result.class_probabilities[0]) > 0.99
        assert int(result.class_index) == 0
        others = torch.tensor(LABELS) != 0
        assert float(result.class_weights[0, others].abs().max()) == 0
        assert 0 < float(result.weights[others].abs().max()) < 0.01
        assert float((result.weights - weights).norm()) < float((0.2 - weights[~others]).norm())

    @pytest.mark.parametrize("penalty", ["paper", 0.01, 1e-4])
    def test_both_solvers_agree(self, basis: BasisImages, penalty):
        image = some_images(3)
        factored, lstsq = (BRDFEstimator(basis, classes_of(), penalty=penalty, solver=s)(image) for s in SOLVERS)
        assert_same(factored, lstsq, rtol=1e-8)

    def test_both_solvers_agree_without_penalty_on_a_badly_conditioned_basis(self, basis: BasisImages):
        """Naive least squares is a method users compare with: a singular value 1e-7 below the largest counts."""
        packed = basis.packed.double()
        packed[[0, 1, 4, 9, 10]] = packed[0] + 1e-7 * packed[[0, 1, 4, 9, 10]]
        nearly = replace(basis, packed=packed)
        image = basis.unpack(basis.packed[[0, 5]].double().sum(0))
        factored, lstsq = (BRDFEstimator(nearly, classes_of(), penalty=0.0, solver=s)(image) for s in SOLVERS)
        assert torch.allclose(factored.class_errors, lstsq.class_errors, rtol=1e-3)

    @pytest.mark.parametrize("exponent", [-20, -3, 10, 40])
    @pytest.mark.parametrize("method", METHODS)
    def test_scaling_probe_and_photograph_together_changes_no_weight(
        self, basis: BasisImages, method: str, exponent: int
    ):
        image, s = some_images(), 2.0**exponent
        one = BRDFEstimator(basis, classes_of(), **METHODS[method])(image)
        scaled = BRDFEstimator(replace(basis, packed=basis.packed * s), classes_of(), **METHODS[method])(image * s)
        for field in ("weights", "class_weights", "class_probabilities"):
            assert torch.allclose(getattr(one, field), getattr(scaled, field), rtol=1e-9, atol=1e-12), field
        assert int(one.class_index) == int(scaled.class_index)
        assert torch.allclose(one.relative_error, scaled.relative_error, rtol=1e-9)

    def test_a_black_channel_gets_no_weight(self, estimator: BRDFEstimator):
        image = some_images()
        image[1] = 0
        result = estimator(image)
        assert float(result.class_weights[:, :, 1].abs().max()) < 1e-12
        assert float(result.weights[:, 0].abs().max()) > 0


class TestBatches:
    def test_a_batch_is_a_loop(self, any_estimator: BRDFEstimator):
        images = some_images(4)
        batch = any_estimator(images)
        assert len(batch) == 4
        for i in range(4):
            assert_same(batch[i], any_estimator(images[i]))

    def test_shapes(self, any_estimator: BRDFEstimator):
        for batch in ((), (1,), (2,), (2, 3), (1, 1)):
            result = any_estimator(some_images(*batch))
            assert result.class_weights.shape == (*batch, 3, 12, 3)
            assert result.weights.shape == (*batch, 12, 3)
            assert result.class_errors.shape == (*batch, 3)
            assert result.class_index.shape == result.energy.shape == result.relative_error.shape == batch
            assert result.image.shape == (*batch, 3, HEIGHT, WIDTH)
            assert result.class_index.dtype == torch.int64

    def test_nested_batches(self, any_estimator: BRDFEstimator):
        images = some_images(2, 3)
        nested, flat = any_estimator(images), any_estimator(images.reshape(6, 3, HEIGHT, WIDTH))
        assert torch.allclose(nested.weights.reshape(6, 12, 3), flat.weights)
        assert_same(nested[1][2], flat[5])

    def test_picking_from_a_batch(self, estimator: BRDFEstimator):
        result = estimator(some_images(2))
        assert torch.equal(result[-1].weights, result.weights[1])
        single = result[0]
        assert repr(result).startswith("Reconstruction(2 photographs, ")
        assert re.fullmatch(r"Reconstruction\(class \d of \d \(\d+%\), relative error \d+\.\d\d%\)", repr(single))
        with pytest.raises(TypeError, match="a single reconstruction has no length"):
            len(single)
        with pytest.raises(IndexError, match="no batch axis"):
            single[0]

    def test_an_empty_batch_stays_empty(self, any_estimator: BRDFEstimator):
        """The last, empty, batch of a data loader."""
        assert any_estimator(some_images(0)).weights.shape == (0, 12, 3)

    def test_precision_follows_the_photograph(self, any_estimator: BRDFEstimator):
        image = some_images(2)
        single, double = any_estimator(image.float()), any_estimator(image)
        for field in ("weights", "class_weights", "class_probabilities", "relative_error", "image"):
            assert getattr(single, field).dtype == torch.float32
        for field in ("class_errors", "error", "energy"):  # squares
            assert getattr(single, field).dtype == torch.float64
            assert getattr(double, field).dtype == torch.float64
        assert torch.allclose(single.weights.double(), double.weights, rtol=1e-4, atol=1e-5)

    def test_memory_layout_does_not_matter(self, any_estimator: BRDFEstimator):
        image = some_images(2)
        expected = any_estimator(image)
        assert_same(any_estimator(image.to(memory_format=torch.channels_last)), expected)
        wide = torch.zeros(2, 3, HEIGHT, 2 * WIDTH, dtype=torch.float64)
        wide[..., ::2] = image
        assert not wide[..., ::2].is_contiguous()
        assert_same(any_estimator(wide[..., ::2]), expected)
        assert_same(any_estimator(image.transpose(-1, -2).contiguous().transpose(-1, -2)), expected)

    def test_the_photograph_is_not_written_to(self, any_estimator: BRDFEstimator):
        image, mask = some_images(2), some_masks(2)
        before = image.clone(), mask.clone()
        any_estimator(image, mask)
        assert torch.equal(image, before[0])
        assert torch.equal(mask, before[1])


class TestMasks:
    def cropped(self, basis: BasisImages, mask: Tensor) -> BasisImages:
        """The basis images of the pixels under both masks only."""
        both = basis.mask & mask
        return replace(basis, packed=basis.packed[..., basis.pack(mask)[0]], mask=both)

    def test_is_the_same_as_cropping_the_pixels(self, estimator: BRDFEstimator, basis: BasisImages):
        """But for the scale of the residuals and the neighbourhoods of "auto", which are those of the whole view."""
        image, mask = some_images(), some_masks()
        small = BRDFEstimator(self.cropped(basis, mask), classes_of(), **settings_of(estimator))
        masked, direct = estimator(image, mask), small(image)
        near = 0.02 if estimator.penalty == "auto" else 1e-9
        assert torch.allclose(masked.class_weights, direct.class_weights, rtol=near, atol=near / 10)
        assert torch.allclose(masked.class_errors, direct.class_errors, rtol=max(near, 1e-5))
        assert torch.allclose(masked.energy, direct.energy)
        assert int(masked.class_index) == int(direct.class_index)
        assert not torch.allclose(masked.weights, estimator(image).weights, rtol=1e-3)

    def test_each_photograph_may_have_its_own(self, any_estimator: BRDFEstimator):
        images, masks = some_images(4), some_masks(4)
        masks[2] = masks[0]
        batch = any_estimator(images, masks)
        for i in range(4):
            assert_same(batch[i], any_estimator(images[i], masks[i]))

    def test_one_for_the_whole_batch(self, any_estimator: BRDFEstimator):
        images, mask = some_images(3), some_masks()
        assert_same(any_estimator(images, mask), any_estimator(images, mask.expand(3, -1, -1, -1)))

    def test_a_full_one_changes_nothing(self, any_estimator: BRDFEstimator):
        images = some_images(2)
        assert_same(any_estimator(images, torch.ones(1, HEIGHT, WIDTH, dtype=torch.bool)), any_estimator(images))

    def test_the_fitted_image_fills_the_view(self, estimator: BRDFEstimator, basis: BasisImages):
        result = estimator(some_images(), some_masks())
        assert (basis.pack(result.image) != 0).all()
        assert float(result.image[:, ~basis.mask[0]].abs().max()) == 0

    @pytest.mark.parametrize("garbage", [float("nan"), float("inf"), 1e30, -5.0])
    def test_what_lies_outside_does_not_matter(self, any_estimator: BRDFEstimator, basis: BasisImages, garbage: float):
        """Neither outside the mask nor outside the view; neither forward nor backward."""
        image, mask = some_images(2), some_masks(2)
        dirty = image.clone()
        dirty[(~mask).expand_as(dirty)] = garbage
        outside_view = (~basis.mask).expand_as(dirty)
        dirty[outside_view] = garbage
        image.requires_grad_()
        dirty.requires_grad_()
        clean_result, dirty_result = any_estimator(image, mask), any_estimator(dirty, mask)
        assert_same(dirty_result, clean_result)
        for result in (clean_result, dirty_result):
            (result.weights.square().sum() + result.relative_error.sum() + result.image.sum()).backward()
        assert torch.isfinite(dirty.grad).all()
        assert float(dirty.grad[(~mask).expand_as(dirty)].abs().max()) == 0
        assert float(dirty.grad[outside_view].abs().max()) == 0
        assert torch.allclose(dirty.grad, image.grad)
        assert float(dirty.grad.abs().max()) > 0


class TestRelativeError:
    """Squares of what float32 holds leave float32 beyond 1e19 and below 1e-23."""

    @pytest.mark.parametrize("exponent", [-100, -80, 0, 64, 100])
    def test_a_photograph_in_float32_is_explained_as_well_as_in_float64(self, any_estimator, exponent: int):
        image = some_images(2).float() * 2.0**exponent
        single, double = any_estimator(image), any_estimator(image.double())
        assert single.relative_error.dtype == torch.float32
        assert float(double.relative_error.min()) > 0.01
        for field in ("relative_error", "error", "energy", "class_errors"):
            assert torch.allclose(getattr(single, field).double(), getattr(double, field), rtol=1e-3, atol=0), field

    def test_a_hot_pixel_is_seen(self, estimator: BRDFEstimator, basis: BasisImages):
        image = some_images().float()
        row, column = torch.nonzero(basis.mask[0])[3].tolist()
        image[:, row, column] = 1e20
        assert float(estimator(image).relative_error) == pytest.approx(
            float(estimator(image.double()).relative_error), rel=1e-3
        )
        assert float(estimator(image).relative_error) > 0.5

    @pytest.mark.parametrize(("error", "told"), [(float("nan"), "nan%"), (float("inf"), "inf%"), (0.0, "0.00%")])
    def test_only_a_perfect_fit_has_none(self, estimator: BRDFEstimator, error: float, told: str):
        result = replace(estimator(some_images()), error=torch.tensor(error, dtype=torch.float64))
        assert f"relative error {told})" in repr(result)
        assert float(result.relative_error) == pytest.approx(error, nan_ok=True)

    @pytest.mark.parametrize("exponent", [-80, 0])
    def test_gradients_in_float32_are_those_in_float64(self, estimator: BRDFEstimator, exponent: int):
        scaled = some_images().float() * 2.0**exponent
        images = [scaled.requires_grad_(), scaled.detach().double().requires_grad_()]
        single, double = (torch.autograd.grad(estimator(image).relative_error, image)[0].double() for image in images)
        assert float((single - double).norm() / double.norm()) < 1e-3

    def test_a_perfect_fit_has_a_finite_gradient(self, estimator: BRDFEstimator):
        image = some_images().requires_grad_()
        result = estimator(image)
        perfect = replace(result, error=result.error - result.error.detach())
        assert float(perfect.relative_error.detach()) == 0
        assert torch.equal(torch.autograd.grad(perfect.relative_error, image)[0], torch.zeros_like(image))


class TestGradients:
    @pytest.mark.parametrize("solver", SOLVERS)
    @pytest.mark.parametrize("penalty", ["auto", "paper", 0.01, 0.0])
    def test_gradcheck(self, basis: BasisImages, penalty, solver: str):
        if penalty == "auto" and solver == "lstsq":
            pytest.skip('"lstsq" is for fixed penalties')
        solved = BRDFEstimator(basis, classes_of(), penalty=penalty, solver=solver)
        image, mask = some_images().requires_grad_(), some_masks()

        def outputs(image: Tensor) -> tuple[Tensor, ...]:
            result = solved(image, mask)
            return (
                result.weights, result.class_weights, result.class_errors, result.relative_error, result.image[:, :2],
                result.class_probabilities,
            )[: 6 if penalty == "auto" else 5]  # fmt: skip

        assert torch.autograd.gradcheck(outputs, image, fast_mode=True)

    def test_a_black_channel_has_a_finite_gradient(self, any_estimator: BRDFEstimator):
        image = some_images()
        image[2] = 0
        image.requires_grad_()
        any_estimator(image).weights.square().sum().backward()
        assert torch.isfinite(image.grad).all()

    def test_gradient_in_float32(self, any_estimator: BRDFEstimator):
        image = some_images().float().requires_grad_()
        any_estimator(image).weights.sum().backward()
        assert image.grad.dtype == torch.float32
        assert torch.isfinite(image.grad).all()

    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    @pytest.mark.parametrize("method", ["auto", "fixed", "robust", "nonnegative"])
    def test_gradients_after_a_first_use_in_inference_mode(self, basis: BasisImages, method: str, dtype: torch.dtype):
        """Factors and what else is kept from the first photograph on serve those with gradients, too."""
        used, fresh = (BRDFEstimator(basis, classes_of(), **METHODS[method]) for _ in range(2))
        for mask in (None, some_masks()):
            with torch.inference_mode():
                used(some_images(seed=6).to(dtype), mask)
            images = [some_images().to(dtype).requires_grad_() for _ in range(2)]
            for one, image in zip((used, fresh), images, strict=True):
                one(image, mask).weights.square().sum().backward()
            assert torch.equal(images[0].grad, images[1].grad)

    def test_no_gradient_reaches_the_basis(self, estimator: BRDFEstimator):
        assert [p for p in estimator.parameters() if p.requires_grad] == []
        assert not estimator(some_images()).weights.requires_grad


class TestModule:
    def test_state_dict_restores_another_probe(self, basis: BasisImages):
        image = some_images()
        for method in METHODS.values():
            source = BRDFEstimator(synthetic(seed=1), classes_of(), **method)
            target = BRDFEstimator(basis, classes_of((0,) * 4 + (1,) * 4 + (2,) * 4), **method)
            target(image)
            target.load_state_dict(source.state_dict())
            assert_same(target(image), source(image))

    @pytest.mark.parametrize(
        ("changed", "said"),
        [
            ({"probe": "0123456789"}, "light (P -> 01234567): photographs are now explained under that light"),
            ({"view": "9876543210"}, "view (V -> 98765432): photographs are now explained under that view"),
            (
                {"probe": "0123456789", "view": "9876543210"},
                "light (P -> 01234567) and view (V -> 98765432): photographs are now explained under that light and "
                "view",
            ),
        ],
    )
    def test_a_state_dict_that_changes_the_light_says_so_once(self, basis: BasisImages, changed, said):
        estimator, other = BRDFEstimator(basis, classes_of()), BRDFEstimator(replace(basis, **changed), classes_of())
        said = f"estimate: the state_dict holds another {said}"
        with pytest.warns(UserWarning, match=f"^{re.escape(said)}$") as told:
            nn.ModuleDict({"estimate": estimator}).load_state_dict(nn.ModuleDict({"estimate": other}).state_dict())
        assert len(told) == 1
        assert (estimator.probe, estimator.view) == (other.probe, other.view)

    def test_every_estimator_of_a_network_tells_of_its_own_light(self, basis: BasisImages):
        """Of warnings of one text from one place Python shows the first alone."""
        first, other = (
            nn.ModuleDict({name: BRDFEstimator(replace(basis, probe=probe), classes_of()) for name in ("near", "far")})
            for probe in ("P", "Q")
        )
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("default")
            first.load_state_dict(other.state_dict())
        assert [str(one.message).partition(":")[0] for one in told] == ["near", "far"]

    def test_a_state_dict_of_the_same_light_is_loaded_in_silence(self, basis: BasisImages):
        estimator = BRDFEstimator(basis, classes_of())
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            estimator.load_state_dict(BRDFEstimator(basis, classes_of()).state_dict())

    @pytest.mark.parametrize("part", ["packed", "mask_0", "_extra_state"])
    def test_basis_images_and_what_they_show_are_loaded_together(self, basis: BasisImages, part: str):
        """As from a file that holds tensors only; of the same basis images that is enough."""
        pipeline = nn.ModuleDict({"estimate": BRDFEstimator(basis, classes_of())})
        other = nn.ModuleDict({"estimate": BRDFEstimator(replace(synthetic(seed=1), probe="other"), classes_of())})
        image, without = some_images(), f"estimate.{part}"
        expected = pipeline["estimate"](image)
        with pytest.raises(
            ValueError, match=f"holds only a part of what another BRDFEstimator is, without {re.escape(without)};"
        ):
            pipeline.load_state_dict({k: v for k, v in other.state_dict().items() if k != without}, strict=False)
        pipeline.load_state_dict({k: v for k, v in pipeline.state_dict().items() if k != without}, strict=False)
        assert pipeline["estimate"].probe == "P"
        assert_same(pipeline["estimate"](image), expected)

    def test_a_state_without_the_estimator_leaves_it_as_it_is(self, basis: BasisImages):
        pipeline = nn.ModuleDict({"estimate": BRDFEstimator(basis, classes_of())})
        image = some_images()
        expected = pipeline["estimate"](image)
        pipeline.load_state_dict({}, strict=False)
        assert_same(pipeline["estimate"](image), expected, rtol=0)

    @pytest.mark.parametrize("masked", [False, True])
    @pytest.mark.parametrize("way", ["replaced", "overwritten", "called"])
    def test_other_basis_images_take_effect(self, any_estimator: BRDFEstimator, way: str, masked: bool):
        """What was made of those before is not used on."""
        image, other = some_images(), synthetic(seed=1)
        mask = some_masks() if masked else None
        expected = BRDFEstimator(other, classes_of(), **settings_of(any_estimator))(image, mask)
        before = any_estimator(image, mask)
        if way == "called":
            assert_same(torch.func.functional_call(any_estimator, {"packed": other.packed}, (image, mask)), expected)
            assert_same(any_estimator(image, mask), before)
            return
        if way == "replaced":
            any_estimator.packed = other.packed
        else:
            any_estimator.packed.copy_(other.packed)
        assert_same(any_estimator(image, mask), expected)

    def test_other_classes_take_effect(self, any_estimator: BRDFEstimator, basis: BasisImages):
        image, labels = some_images(), LABELS[::-1]
        any_estimator(image)
        any_estimator.classes.labels = torch.tensor(labels)
        assert_same(any_estimator(image), BRDFEstimator(basis, classes_of(labels), **settings_of(any_estimator))(image))

    def test_repr_tells_lights_apart(self, basis: BasisImages):
        lit = (replace(basis, probe=probe) for probe in ("0123456789ab", "ba9876543210"))
        first, second = (repr(BRDFEstimator(one, classes_of())) for one in lit)
        assert "light=01234567\n" in first
        assert "light=ba987654\n" in second

    def test_repr_on_the_meta_device(self, basis: BasisImages):
        """Which tells no values, so no sizes of classes."""
        assert "MaterialClasses(12 basis BRDFs)" in repr(BRDFEstimator(basis, classes_of()).to("meta"))

    def test_state_dict_survives_a_file_and_nesting(self, basis: BasisImages, tmp_path):
        pipeline = nn.ModuleDict({"estimate": BRDFEstimator(synthetic(seed=1), classes_of())})
        torch.save(pipeline.state_dict(), tmp_path / "state.pt")
        fresh = nn.ModuleDict({"estimate": BRDFEstimator(basis, classes_of())})
        image = some_images()
        fresh["estimate"](image)
        fresh.load_state_dict(torch.load(tmp_path / "state.pt", weights_only=True))
        assert_same(fresh["estimate"](image), pipeline["estimate"](image))

    def test_state_dict_of_another_library_is_refused_and_changes_nothing(self, basis: BasisImages):
        estimator = BRDFEstimator(basis, classes_of())
        image = some_images()
        before = estimator(image)
        other = BRDFEstimator(synthetic(seed=1, library="other"), classes_of(library="other"))
        with pytest.raises(ValueError, match="this state_dict belongs to an estimator with another material library"):
            estimator.load_state_dict(other.state_dict())
        assert_same(estimator(image), before)
        assert torch.equal(estimator.packed, basis.packed)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                lambda state: state | {"mask_0": torch.ones(1, 4, 5) > 0, "packed": torch.ones(12, 3, 20)},
                "BRDFEstimator: the state_dict is of photographs of 4 x 5 (20 pixels), and this estimator is of 7 x 9 "
                "(37 pixels); load it into an estimator of that view",
            ),
            (
                lambda state: state | {"mask_1": torch.ones(1, 4, 5) > 0, "packed": torch.ones(12, 3, 57)},
                "BRDFEstimator: the state_dict is of photographs of 7 x 9 and 4 x 5 (57 pixels), and this estimator is "
                "of 7 x 9 (37 pixels); load it into an estimator of that view",
            ),
            (
                lambda state: state | {"packed": torch.ones(9, 3, 37)},
                "this state_dict holds (9, 3, 37) as packed, expected (12, 3, 37)",
            ),
            (
                lambda state: state | {"classes.norms": torch.ones(9)},
                "this state_dict holds (9,) as classes.norms, expected (12,)",
            ),
            (lambda state: state | {"packed": [1]}, "this state_dict holds list as packed, expected (12, 3, 37)"),
            (
                lambda state: {key: one for key, one in state.items() if key != "classes.norms"},
                "this state_dict holds only a part of what another BRDFEstimator is, without classes.norms; load the "
                "whole state of one, or leave all of it out",
            ),
        ],
        ids=["size", "two photographs", "shape", "classes", "no tensor", "absent"],
    )
    @pytest.mark.filterwarnings("error")
    def test_a_state_that_does_not_fit_changes_nothing(self, basis: BasisImages, change, message: str):
        """Not the light that the estimator says it explains photographs under, nor does it say that it will."""
        estimator = BRDFEstimator(basis, classes_of(), penalty=0.1)
        before = {key: copy.copy(one) for key, one in estimator.state_dict().items()}
        other = BRDFEstimator(replace(synthetic(seed=1), probe="other", view="other"), classes_of(LABELS[::-1]))
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            estimator.load_state_dict(change(other.state_dict()))
        after = estimator.state_dict()
        assert after.pop("_extra_state") == before.pop("_extra_state")
        assert all(torch.equal(after[key], one) for key, one in before.items())

    @pytest.mark.parametrize("assign", [False, True])
    def test_loading_a_state_changes_no_one_else(self, basis: BasisImages, assign: bool):
        """Neither the basis images and classes that an estimator was made from, nor others that were made from them."""
        classes, image = classes_of(), some_images()
        loaded, sibling = BRDFEstimator(basis, classes), BRDFEstimator(basis, classes)
        packed, labels, expected = basis.packed.clone(), classes.labels.clone(), sibling(image)
        other = BRDFEstimator(synthetic(seed=1), classes_of(LABELS[::-1]))
        answer = other(image)
        loaded.load_state_dict(other.state_dict(), assign=assign)
        assert_same(loaded(image), answer)
        assert_same(BRDFEstimator(basis, classes)(image), expected, rtol=0)
        assert_same(sibling(image), expected, rtol=0)
        loaded.load_state_dict(sibling.state_dict())
        assert torch.equal(basis.packed, packed)
        assert torch.equal(classes.labels, labels)
        assert_same(other(image), answer, rtol=0)

    def test_classes_load_into_tensors_of_their_own(self):
        first, other = classes_of(), classes_of(LABELS[::-1])
        twin = copy.copy(first)
        twin.load_state_dict(other.state_dict())
        assert torch.equal(twin.labels, other.labels)
        assert torch.equal(first.labels, torch.tensor(LABELS))

    @pytest.mark.parametrize("used", [False, True])
    def test_a_cast_to_a_half_type_changes_no_weight(self, any_estimator: BRDFEstimator, used: bool):
        image, fresh = some_images(), copy.deepcopy(any_estimator)
        if used:
            fresh(image)
        assert_same(fresh.bfloat16()(image), any_estimator(image), rtol=0)
        assert_same(fresh.half().float()(image.float()), any_estimator(image.float()), rtol=1e-5)

    @pytest.mark.parametrize("used", [False, True])
    def test_a_cast_to_float64_and_back(self, any_estimator: BRDFEstimator, used: bool):
        image, cast = some_images(), copy.deepcopy(any_estimator)
        if used:
            cast(image)
        assert_same(cast.to(torch.float64)(image), any_estimator(image))
        assert_same(cast.to(torch.float32)(image), any_estimator(image), rtol=1e-5)

    def test_casting_an_estimator_leaves_the_classes_of_others_alone(self, basis: BasisImages):
        classes = classes_of()
        BRDFEstimator(basis, classes).float()
        assert classes.norms.dtype == torch.float64

    def test_copies_work(self, any_estimator: BRDFEstimator):
        image = some_images()
        expected = any_estimator(image)
        assert_same(copy.deepcopy(any_estimator)(image), expected)

    def test_saving_the_whole_module(self, any_estimator: BRDFEstimator, tmp_path):
        """torch.save(model), or handing it to another process, pickles it."""
        torch.save(any_estimator, tmp_path / "estimator.pt")
        again = torch.load(tmp_path / "estimator.pt", weights_only=False)
        assert_same(again(some_images()), any_estimator(some_images()))

    def test_moving_between_devices(self, estimator: BRDFEstimator):
        device = "cuda" if torch.cuda.is_available() else "cpu"
        image = some_images(2)
        expected = estimator(image)
        moved = estimator.to(device)(image.to(device), some_masks(2).fill_(True).to(device))
        assert moved.weights.device.type == device
        assert torch.allclose(moved.weights.cpu(), expected.weights, rtol=1e-6, atol=1e-9)

    def test_repr_says_how_it_solves(self, basis: BasisImages):
        text = repr(BRDFEstimator(basis, classes_of(), penalty=0.25, solver="lstsq"))
        assert "penalty=0.25" in text
        assert "lstsq" in text

    def test_basis_and_classes_of_different_libraries(self, basis: BasisImages):
        for classes in (classes_of(library="other"), classes_of(LABELS[:9])):
            with pytest.raises(ValueError, match="basis images and classes come from different libraries"):
                BRDFEstimator(basis, classes)

    @pytest.mark.parametrize("penalty", [-0.1, float("nan"), float("inf"), "strong", None])
    def test_impossible_penalty(self, basis: BasisImages, penalty):
        with pytest.raises(ValueError, match='penalty must be "auto", "paper" or a number >= 0, got'):
            BRDFEstimator(basis, classes_of(), penalty=penalty)

    def test_unknown_solver(self, basis: BasisImages):
        with pytest.raises(ValueError, match="""solver must be "factored" or "lstsq", got 'qr'"""):
            BRDFEstimator(basis, classes_of(), solver="qr")

    @pytest.mark.parametrize("more", [{}, {"penalty": 0.1, "constraint": "convex"}])
    def test_lstsq_is_for_a_fixed_penalty_without_constraint(self, basis: BasisImages, more):
        with pytest.raises(ValueError, match='solver "lstsq" is for a fixed penalty without constraint; leave it out'):
            BRDFEstimator(basis, classes_of(), solver="lstsq", **more)

    def test_unknown_constraint(self, basis: BasisImages):
        with pytest.raises(
            ValueError, match="constraint must be None or one of nonnegative, convex, energy, lobes, got 'sum'"
        ):
            BRDFEstimator(basis, classes_of(), constraint="sum")

    @pytest.mark.parametrize("constraint", ["energy", "lobes"])
    def test_bounds_need_the_library(self, basis: BasisImages, tiny_library: MaterialLibrary, constraint: str):
        for library in (None, tiny_library):
            with pytest.raises(ValueError, match=f'constraint "{constraint}" needs the library of the basis images'):
                BRDFEstimator(basis, classes_of(), constraint=constraint, library=library)

    def test_no_basis_at_all(self):
        with pytest.raises(ValueError, match="basis is an empty sequence; give the basis images of each photograph"):
            BRDFEstimator([], classes_of())

    def test_arguments_of_other_types(self, basis: BasisImages, tiny_library: MaterialLibrary):
        estimator = BRDFEstimator(basis, classes_of())
        result = estimator(some_images())
        needed = {
            "BasisImages": "make them with tb.render_basis(library, probe, view)",
            "MaterialClasses": "make them with tb.MaterialClasses.fit(library)",
            "MaterialLibrary": "open one with tb.MaterialLibrary.default()",
            "swapped": "the order is BRDFEstimator(basis, classes)",
        }
        for call, given, message, remedy in [
            (BRDFEstimator, (classes_of(), basis), "basis must be a BasisImages, got a MaterialClasses", "swapped"),
            (BRDFEstimator, ([basis.packed], classes_of()), "basis must be a BasisImages, got a Tensor", "BasisImages"),
            (
                BRDFEstimator,
                (basis, tiny_library),
                "classes must be a MaterialClasses, got a MaterialLibrary",
                "MaterialClasses",
            ),
            (estimator.rehearse, (basis.packed[0, 0],), "novel must be a BasisImages, got a Tensor", "BasisImages"),
            (
                estimator.observability,
                (None, tiny_library),
                "novel must be a BasisImages, got a MaterialLibrary",
                "BasisImages",
            ),
            (result.image_std, ([basis],), "basis must be a BasisImages, got a list", "BasisImages"),
            *(
                (call, (*more, basis), "library must be a MaterialLibrary, got a BasisImages", "MaterialLibrary")
                for call, more in {
                    MaterialClasses.fit: (),
                    estimator.observability: (),
                    result.brdf: (),
                    result.brdf_std: (),
                    result.tables: (),
                    result.candidate: (0,),
                }.items()
            ),
        ]:
            with pytest.raises(ValueError, match=f"^{call.__qualname__}: {re.escape(f'{message}; {needed[remedy]}')}$"):
                call(*given)


class TestBadPhotographs:
    @pytest.mark.parametrize("shape", [(3, HEIGHT, WIDTH + 1), (1, HEIGHT, WIDTH), (HEIGHT, WIDTH), (3, WIDTH, HEIGHT)])
    def test_wrong_size(self, estimator: BRDFEstimator, shape: tuple[int, ...]):
        expected = (
            r"image must be \(\*batch, 3, 7, 9\) like the basis images, got \(" + ", ".join(map(str, shape)) + r"\)"
        )
        with pytest.raises(ValueError, match=expected):
            estimator(torch.rand(shape))

    @pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.uint8, torch.int32])
    def test_wrong_precision(self, estimator: BRDFEstimator, dtype: torch.dtype):
        image = (100 * some_images()).to(dtype)
        with pytest.raises(ValueError, match=f"image must be float32 or float64 linear radiance, got {dtype}"):
            estimator(image)

    @pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
    def test_unsound_pixels_are_counted(self, estimator: BRDFEstimator, basis: BasisImages, value: float):
        image, mask = some_images(), some_masks()
        row, column = torch.nonzero((mask & basis.mask)[0])[3].tolist()
        image[:2, row, column] = value
        message = "image holds NaN or infinite values, in 1 of the 2[0-9] pixels under the mask; mask them out"
        with pytest.raises(ValueError, match=message):
            estimator(image, mask)
        mask[0, row, column] = False
        assert torch.isfinite(estimator(image, mask).weights).all()

    def test_black(self, estimator: BRDFEstimator):
        images = some_images(3)
        images[1] = 0
        with pytest.raises(ValueError, match="image is black at index 1 of a batch of 3: every pixel under the mask"):
            estimator(images)

    def test_black_under_the_mask_only(self, estimator: BRDFEstimator):
        image, mask = some_images(), some_masks()
        image[mask.expand_as(image)] = 0
        with pytest.raises(ValueError, match="is black: every pixel under the mask is 0"):
            estimator(image, mask)

    def test_empty_mask(self, estimator: BRDFEstimator):
        masks = some_masks(2)
        masks[1] = False
        with pytest.raises(ValueError, match="mask leaves no pixel of the view to use at index 1 of a batch of 2"):
            estimator(some_images(2), masks)

    def test_mask_that_holds_only_pixels_outside_the_view(self, estimator: BRDFEstimator, basis: BasisImages):
        with pytest.raises(ValueError, match="mask leaves no pixel of the view to use"):
            estimator(some_images(), ~basis.mask)

    @pytest.mark.parametrize("shape", [(HEIGHT, WIDTH), (1, WIDTH, HEIGHT), (3, HEIGHT, WIDTH), (3, 1, HEIGHT, WIDTH)])
    def test_mask_of_another_size(self, estimator: BRDFEstimator, shape: tuple[int, ...]):
        with pytest.raises(ValueError, match=r"mask must be bool \(1, 7, 9\).*, got torch.bool"):
            estimator(some_images(2), torch.ones(shape, dtype=torch.bool))

    def test_mask_of_numbers(self, estimator: BRDFEstimator):
        with pytest.raises(ValueError, match=r"mask must be bool .*, got torch\.float32"):
            estimator(some_images(), torch.ones(1, HEIGHT, WIDTH))


class TestWholePath:
    """A small library, rendered, estimated and rendered again."""

    def test_a_material_of_the_library_is_recovered(self, rendered, tiny_library: MaterialLibrary, tiny_tables):
        basis, _, view = rendered
        estimator = BRDFEstimator(basis, MaterialClasses.single(tiny_library), penalty=1e-8)
        for name in ("red", "plastic-0.1"):
            result = estimator(basis.image(name))
            assert float(result.relative_error) < 0.01
            table = result.brdf(tiny_library)
            again = render(table, LightProbe(torch.ones(3, 16, 32)), view, samples=512)
            truth = render(tiny_tables[name], LightProbe(torch.ones(3, 16, 32)), view, samples=512)
            assert float((again - truth).norm() / truth.norm()) < 0.05

    def test_brdf_is_the_combination_of_the_chosen_class(self, rendered, tiny_library: MaterialLibrary):
        basis, *_ = rendered
        half = tiny_library.n // 2
        labels = (0,) * half + (1,) * half
        classes = classes_of(labels, tiny_library.source)
        classes.names = tiny_library.names
        result = BRDFEstimator(basis, classes)(basis.image("gold-0.3"))
        j = int(result.class_index)
        for table, weights in (
            (result.brdf(tiny_library), result.weights),
            (result.candidate(1 - j, tiny_library), result.class_weights[1 - j]),
        ):
            expected = tiny_library.combine(weights).values
            assert torch.equal(table.values[above_horizon()], expected[above_horizon()])

    def test_brdf_needs_one_reconstruction_and_the_same_library(self, rendered, tiny_library: MaterialLibrary):
        basis, *_ = rendered
        estimator = BRDFEstimator(basis, MaterialClasses.single(tiny_library))
        batch = estimator(basis.image("red")[None])
        with pytest.raises(ValueError, match=r"this holds a batch \(1,\); pick one: result\[i\]"):
            batch.brdf(tiny_library)
        with pytest.raises(ValueError, match="not the one that the basis images were rendered with"):
            batch[0].brdf(tiny_library.without("red"))
        assert batch[0].brdf(tiny_library).valid.any()
