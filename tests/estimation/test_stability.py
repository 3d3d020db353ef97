"""What the estimator does with awkward input: `stability_cases.CASES` through every penalty, and its invariances.

docs/stability.md lists the cases with what happens and why.
"""

import ctypes
import gc
import inspect
import os
import platform
import tracemalloc
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings, strategies as st
from torch import Tensor

import torchbrdf as tb
from stability_cases import CASES, LABELS, Case, classes_of, photograph, synthetic
from torchbrdf.brdf import columns_of
from torchbrdf.brdf._library_building import build_in_memory
from torchbrdf.brdf.column_sources import EmbeddedSource
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.estimation.estimator import BRDFEstimator
from torchbrdf.estimation.priors import bank
from torchbrdf.estimation.reconstruction import Reconstruction
from torchbrdf.estimation.settings import PAPER_PENALTY
from torchbrdf.estimation.solvers import balance
from torchbrdf.transport.basis_images import BasisImages

EPS = torch.finfo(torch.float64).eps
DEFAULT = inspect.signature(BRDFEstimator).parameters["penalty"].default
REGULARISED = list(dict.fromkeys([DEFAULT, "paper", 0.0005]))
PENALTIES = [*REGULARISED, 0.0]
METHODS = [{"penalty": DEFAULT}, *({"penalty": "paper", "solver": solver} for solver in ("factored", "lstsq"))]

each_case = pytest.mark.parametrize("name", CASES)
each_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: "-".join(method.values()))
each_penalty = pytest.mark.parametrize("penalty", PENALTIES)
each_regularised = pytest.mark.parametrize("penalty", REGULARISED)
regularised = st.sampled_from(REGULARISED)
quickly = settings(derandomize=True, deadline=None, max_examples=15)


def scaled(case: Case, scale: float) -> Case:
    """Probe and photograph together; the basis images stand for the probe."""
    return replace(case, basis=replace(case.basis, packed=case.basis.packed * scale), image=case.image * scale)


def estimator_of(case: Case, **options) -> BRDFEstimator:
    return BRDFEstimator(case.basis, case.classes, **{**case.options, **options})


def estimate(case: Case, **options) -> Reconstruction:
    return estimator_of(case, **options)(case.image, case.mask)


def tensors(result: Reconstruction) -> Iterator[tuple[str, Tensor]]:
    for field in fields(result):
        if isinstance(getattr(result, field.name), Tensor):
            yield field.name, getattr(result, field.name)
    for name in ("weights", "relative_error"):
        yield name, getattr(result, name)


def assert_finite(result: Reconstruction) -> None:
    for name, values in tensors(result):
        assert torch.isfinite(values).all(), name


def backward(result: Reconstruction) -> None:
    """The gradient of all outputs that have one, each with a factor of its own."""
    outputs = [values for _, values in tensors(result) if values.requires_grad]
    assert len(outputs) >= 5
    sum((k + 1) * values.sum() for k, values in enumerate(outputs)).backward()


def difference(a: Tensor, b: Tensor) -> float:
    """Largest deviation relative to the largest value."""
    return float((a - b).detach().abs().max() / a.detach().abs().max().clamp_min(1e-300))


def weight_change(a: Reconstruction, b: Reconstruction) -> float:
    """Largest change of a weight; the class must be the same, unless several are equally probable."""
    top = a.class_probabilities.topk(min(2, a.class_probabilities.shape[-1])).values
    tie = top[..., 0] - top[..., -1] < 1e-6 if top.shape[-1] > 1 else torch.zeros_like(a.class_index, dtype=torch.bool)
    assert (tie | (a.class_index == b.class_index)).all()
    return difference(a.weights, b.weights)


def another_order(case: Case, penalty: float | str) -> Tensor:
    """(*batch, K, 3): the norm by which a class's weights may move where sums over pixels are taken in another order.

    A sum of P products is off by sqrt(P) eps times the sum of their sizes: errors add up like a random walk. The
    weights solve (Y^T Y + lambda I) w = Y^T y + lambda mu, and the smallest eigenvalue divides what Y^T y is off by:
    eps times the squared condition number of Y, which lambda bounds. To factor Y rounds less than that.
    """
    fixed = PAPER_PENALTY if penalty == "paper" else float(penalty)
    y, bounds = case.basis.pack(case.image).double(), []
    for j in range(case.classes.n_classes):
        columns = case.basis.packed[case.classes.members(j)].double()
        terms = torch.einsum("nsp,...sp->...sn", columns.abs(), y.abs()).norm(dim=-1)
        smallest = torch.linalg.svdvals(columns.transpose(0, 1))[:, -1].square()
        smallest = smallest + balance(fixed, y.square().sum(-1), len(columns))
        bounds.append(y.shape[-1] ** 0.5 * EPS * terms / smallest)
    return torch.stack(bounds, -2)


def moved(a: Reconstruction, b: Reconstruction) -> Tensor:
    """(*batch, K, 3): the norm by which a class's weights differ."""
    return (a.class_weights - b.class_weights).norm(dim=-2)


class TestEveryCase:
    @each_penalty
    @each_case
    def test_forward_and_backward_are_finite(self, name: str, penalty):
        case = CASES[name]()
        image = case.image.clone().requires_grad_()
        result = estimator_of(case, penalty=penalty)(image, case.mask)
        assert_finite(result)
        assert float(result.relative_error.detach()) < 2
        backward(result)
        assert torch.isfinite(image.grad).all()

    @each_case
    def test_float32_photographs(self, name: str):
        """The estimator computes in float64: only the rounding of the result differs, in which squares stay in float64.

        And that of the fitted image, a sum over the directions of the space in float32: in the sum and in six more
        steps, from the factors of its products to the scale, by eps of the terms each, as a random walk.
        """
        case = CASES[name]()
        case = replace(case, image=case.image.float().requires_grad_())
        estimator = estimator_of(case)
        single = estimator(case.image, case.mask)
        squares = {"class_errors", "error", "energy"}
        for field, values in tensors(single):
            if values.is_floating_point():
                assert values.dtype == (torch.float64 if field in squares else torch.float32), field
        assert_finite(single)
        backward(single)
        assert torch.isfinite(case.image.grad).all()
        double = estimator(case.image.detach().double(), case.mask)
        assert weight_change(double, single) < 1e-6
        space = estimator.bank.space
        coordinates = torch.einsum("srn,ns->sr", space.r, double.weights)
        terms = torch.einsum("spr,sr,sp->sp", space.u.abs(), coordinates.abs(), space.scale)
        steps = space.u.shape[-1] + 6
        off = (double.image - single.image.detach()).abs().max()
        assert float(off) <= steps**0.5 * torch.finfo(torch.float32).eps * float(terms.max())

    @pytest.mark.parametrize("exponent", [-26, 26])
    @each_penalty
    @each_case
    def test_no_absolute_scale(self, name: str, penalty, exponent: int):
        case = CASES[name]()
        one, other = (estimate(c, penalty=penalty) for c in (case, scaled(case, 2.0**exponent)))
        assert weight_change(one, other) < 1e-6
        assert difference(one.image, other.image * 2.0**-exponent) < 1e-6
        assert difference(one.relative_error, other.relative_error) < 1e-6

    @each_case
    def test_the_default_does_not_blow_up(self, name: str):
        """The weights stay within a hundredfold of what one basis image needs to be as bright as the photograph."""
        case = CASES[name]()
        result = estimate(case)
        columns = case.basis.packed.double().flatten(1).norm(dim=1)
        bright = case.basis.pack(case.image).norm() / columns.amax().clamp_min(1e-30)
        assert float(result.weights.norm()) < 100 * max(1.0, float(bright))

    @each_case
    def test_the_posterior_is_finite_and_positive(self, name: str):
        case = CASES[name]()
        result = estimate(case)
        deviation = result.image_std(case.basis)
        assert deviation.shape == case.image.shape
        assert torch.isfinite(deviation).all()
        assert float(deviation.min()) >= 0
        assert float(deviation.amax()) < 100 * float(case.image.abs().max())
        assert torch.isfinite(result.class_probabilities).all()
        assert float(result.class_probabilities.sum()) == pytest.approx(1)


class TestScale:
    @pytest.mark.parametrize("exponent", [-100, -25, -14, -1, 3, 17, 60])
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    @each_penalty
    def test_powers_of_two(self, penalty, dtype: torch.dtype, exponent: int):
        case = CASES["ordinary"]()
        case = replace(case, image=case.image.to(dtype))
        one, other = (estimate(c, penalty=penalty) for c in (case, scaled(case, 2.0**exponent)))
        assert difference(one.weights, other.weights) < 1e-6

    @pytest.mark.parametrize("scale", [1e-8, 1e-3, 0.7, 1e5, 1e8])
    @each_penalty
    def test_other_scales(self, penalty, scale: float):
        """float32 basis images round differently; a null space is made of nothing but rounding, so float64 there.

        Without a penalty, every product rounds anew: less than another order of the sums may do.
        """
        case = CASES["ordinary"]()
        if penalty == 0:
            case = replace(case, basis=replace(case.basis, packed=case.basis.packed.double()))
        one, other = (estimate(c, penalty=penalty) for c in (case, scaled(case, scale)))
        if penalty == 0:
            assert (moved(one, other) <= another_order(case, penalty)).all()
        assert weight_change(one, other) < 1e-3

    @pytest.mark.parametrize("scale", [1e-8, 1e8])
    @each_case
    def test_other_scales_of_every_case(self, name: str, scale: float):
        case = CASES[name]()
        assert weight_change(estimate(case), estimate(scaled(case, scale))) < 1e-3

    @each_penalty
    def test_a_rendered_probe(self, real: "Real", penalty):
        """For once the probe itself is scaled, and both renderings made again."""
        basis, image = real.basis, real.image
        one = BRDFEstimator(basis, real.classes, penalty=penalty)(image)
        for bright, again in real.scaled:
            assert not torch.equal(bright.packed, basis.packed)
            other = BRDFEstimator(bright, real.classes, penalty=penalty)(again)
            assert weight_change(one, other) < 1e-6

    def test_a_rendered_probe_at_other_scales(self, real: "Real"):
        """Some samples round into a neighbouring cell: much less than other samples would change."""

        def recovered(probe: tb.LightProbe, seed: int) -> Reconstruction:
            basis = tb.render_basis(real.library, probe, real.view, samples=4096, seed=seed)
            return BRDFEstimator(basis, real.classes)(tb.render(real.table, probe, real.view, 4096, seed=1))

        result = recovered(real.probe, 0)
        noise = difference(result.weights, recovered(real.probe, 2).weights)
        for factor in (1e-8, 1e8):
            assert weight_change(result, recovered(real.probe.scaled(factor), 0)) < min(0.03 * noise, 0.01)


class TestColumns:
    @each_regularised
    def test_twins_share_their_weight(self, penalty):
        case = CASES["duplicates"]()
        result = estimate(case, penalty=penalty)
        if penalty == "auto":  # what Y^T Y is off by, over the least penalty: its largest eigenvalue is below the trace
            n, _, pixels = case.basis.packed.shape
            rounding = pixels**0.5 * EPS * n / float(bank.PENALTIES.min())
            assert difference(result.weights[:18], result.weights[18:]) < rounding < 1e-7
        else:  # one direction apart, in which Y is 0 but for rounding, and lambda the whole eigenvalue
            apart = (result.class_weights[:, :18] - result.class_weights[:, 18:]).norm(dim=1)
            assert (apart <= another_order(case, penalty)).all()
        assert float(result.weights.abs().max()) > 0

    @each_regularised
    def test_near_twins_behave_as_twins(self, penalty):
        twins, near = (estimate(CASES[name](), penalty=penalty) for name in ("duplicates", "near_duplicates"))
        assert weight_change(twins, near) < 1e-4
        assert difference(twins.image, near.image) < 1e-5

    @each_penalty
    def test_a_copied_library_explains_no_less(self, penalty):
        case, twice = CASES["ordinary"](), CASES["duplicates"]()
        half = replace(case, basis=case.basis.subset(case.basis.names[:6]), classes=classes_of(LABELS[:18]))
        error = float(estimate(half, penalty=penalty).relative_error)
        assert float(estimate(twice, penalty=penalty).relative_error) < 1.3 * error + 1e-6

    @each_penalty
    def test_a_class_of_one_is_a_number(self, penalty):
        """One column c, weight w: |w c - y| cannot be less than the projection's error."""
        case = CASES["one_member_each"]()
        result = estimate(case, penalty=penalty)
        y = case.basis.pack(case.image)
        for j in range(3):
            column = case.basis.packed[j].double()
            best = (column * y).sum(-1) / column.square().sum(-1)
            floor = (best[:, None] * column - y).square().sum()
            assert float(result.class_errors[j]) >= float(floor) * (1 - 1e-9)
            assert float(result.class_errors[j]) < 0.2 * float(y.square().sum())


class TestFewPixels:
    @pytest.mark.parametrize("name", ["ten_pixels", "one_percent", "as_many_pixels_as_columns"])
    def test_the_default_still_predicts_the_whole_view(self, name: str):
        case = CASES[name]()
        size = 32 if name == "one_percent" else 14
        whole, clean = synthetic(size=size), photograph(size=size, noise=0.0)[0]
        result = estimate(case)
        again = torch.einsum("ns,nsp->sp", result.weights, whole.packed.double())
        truth = whole.pack(clean)
        assert float((again - truth).norm() / truth.norm()) < 0.3

    @each_penalty
    def test_one_pixel_is_explained(self, penalty):
        for name in ("one_pixel", "masked_to_one_pixel"):
            assert float(estimate(CASES[name](), penalty=penalty).relative_error) < 0.01


class TestChannels:
    @each_penalty
    def test_a_black_channel_gets_no_weight(self, penalty):
        result = estimate(CASES["two_black_channels"](), penalty=penalty)
        largest = result.weights.abs().amax(0)
        assert float(largest[:2].max()) < 1e-6 * float(largest[2])

    @each_penalty
    def test_a_channel_without_light_does_not_disturb_the_others(self, penalty):
        """Blue basis images of 0: red and green as if blue had been as usual, in every class.

        With "auto" the channels share prior and penalty: without blue there is less evidence for both.
        """
        cases = (CASES[name]() for name in ("ordinary", "coloured_light_in_the_basis_only"))
        usual, dark = (estimate(case, penalty=penalty) for case in cases)
        if penalty == "auto":
            assert difference(usual.weights[..., :2], dark.weights[..., :2]) < 0.3
            assert difference(usual.class_weights[..., :2], dark.class_weights[..., :2]) < 0.3
            assert difference(usual.image[:2], dark.image[:2]) < 0.02
        else:
            assert difference(usual.class_weights[..., :2], dark.class_weights[..., :2]) < 1e-6


def prediction_error(result: Reconstruction) -> float:
    """Of the fitted image, against the photograph as it was before it was spoilt."""
    clean = photograph(noise=0.0)[0]
    return float((result.image - clean).norm() / clean.norm())


class TestRobust:
    @each_case
    def test_finite_and_without_scale(self, name: str):
        case = CASES[name]()
        image = case.image.clone().requires_grad_()
        result = estimator_of(case, robust=True)(image, case.mask)
        assert_finite(result)
        backward(result)
        assert torch.isfinite(image.grad).all()
        assert weight_change(result, estimate(scaled(case, 2.0**26), robust=True)) < 1e-6

    @pytest.mark.parametrize("name", ["dead_pixels", "hot_pixels", "one_extreme_pixel"])
    def test_a_few_wrong_pixels_do_little_harm(self, name: str):
        case = CASES[name]()
        plain, robust = (prediction_error(estimate(case, robust=robust)) for robust in (False, True))
        assert robust < 0.1
        assert robust < 0.7 * plain

    @pytest.mark.parametrize("name", ["ordinary", "saturated"])
    def test_costs_little_where_nothing_is_wrong(self, name: str):
        case = CASES[name]()
        plain, robust = (prediction_error(estimate(case, robust=robust)) for robust in (False, True))
        assert robust < 1.5 * plain + 0.005


class TestConstraints:
    @pytest.mark.parametrize("constraint", ["nonnegative", "convex"])
    @each_case
    def test_finite_and_feasible(self, name: str, constraint: str):
        case = CASES[name]()
        image = case.image.clone().requires_grad_()
        result = estimator_of(case, constraint=constraint)(image, case.mask)
        assert_finite(result)
        backward(result)
        assert torch.isfinite(image.grad).all()
        weights = result.weights.detach()
        assert float(weights.min()) >= -1e-9 * float(weights.abs().max())
        if constraint == "convex":
            assert torch.allclose(weights.sum(0), torch.ones(3).double(), rtol=1e-6)
        assert weight_change(result, estimate(scaled(case, 2.0**26), constraint=constraint)) < 1e-6


class TestSeveralPhotographs:
    """One ball under the studio's light and under another."""

    @pytest.fixture(params=["ordinary", "one_texel", "sun", "coloured_light", "uniform_light"])
    def pair(self, request: pytest.FixtureRequest) -> tuple[list[BasisImages], list[Tensor]]:
        cases = [CASES["ordinary"](), CASES[request.param]()]
        return [case.basis for case in cases], [case.image for case in cases]

    @each_penalty
    def test_finite_and_without_order_or_scale(self, pair, penalty):
        bases, images = pair
        solved = BRDFEstimator(bases, classes_of(), penalty=penalty)
        traced = [image.clone().requires_grad_() for image in images]
        result = solved(traced)
        assert torch.isfinite(result.weights).all()
        result.weights.square().sum().backward()
        assert all(torch.isfinite(image.grad).all() for image in traced)
        if penalty != 0:
            turned = BRDFEstimator(bases[::-1], classes_of(), penalty=penalty)(images[::-1])
            assert difference(result.weights, turned.weights) < 1e-6
        bright = [replace(basis, packed=basis.packed * 2.0**26) for basis in bases]
        bright = BRDFEstimator(bright, classes_of(), penalty=penalty)([image * 2.0**26 for image in images])
        assert difference(result.weights, bright.weights) < 1e-6

    def test_the_same_photograph_twice_changes_nothing_for_the_paper(self):
        """Both terms of eq. 26 double."""
        case = CASES["ordinary"]()
        twice = BRDFEstimator([case.basis] * 2, case.classes, penalty="paper")([case.image] * 2)
        assert difference(estimate(case, penalty="paper").weights, twice.weights) < 1e-9

    def test_two_exposures_of_one_view(self):
        """The same basis images twice, and each photograph with its own mask: the shared mask is not lost."""
        case = CASES["ordinary"]()
        cut = _without_brightest(case)
        result = BRDFEstimator([case.basis] * 2, case.classes)([case.image] * 2, [cut, None])
        assert len(result.image) == 2
        assert result.image[0].shape == case.image.shape
        torch.testing.assert_close(result.image[0], result.image[1], rtol=1e-9, atol=1e-12)
        assert difference(estimate(case).image, result.image[0]) < 0.05

    def test_a_mask_that_leaves_one_pixel_of_the_second(self):
        case = CASES["masked_to_one_pixel"]()
        solved = BRDFEstimator([case.basis] * 2, case.classes)
        result = solved([case.image] * 2, [torch.ones_like(case.mask), case.mask])
        for image in result.image:
            assert difference(estimate(replace(case, mask=None)).image, image) < 0.1


def _without_brightest(case: Case) -> Tensor:
    luminance = case.image.mean(0, keepdim=True)
    return luminance < luminance[case.basis.mask].quantile(0.95)


class TestInput:
    @pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.complex64, torch.uint8])
    def test_other_precisions_are_refused_in_one_line(self, dtype: torch.dtype):
        case = CASES["ordinary"]()
        with pytest.raises(ValueError, match=f"must be float32 or float64 linear radiance, got {dtype}") as caught:
            estimator_of(case)(case.image.to(dtype))
        assert "\n" not in str(caught.value)

    @each_penalty
    def test_memory_layout_changes_no_bit(self, penalty):
        case = CASES["ordinary"]()
        image, mask = photograph(count=3), torch.stack([CASES["one_percent"]().mask[:, :14, :14] | case.basis.mask] * 3)
        mask[1, 0, 4:7] = False
        estimator = estimator_of(case, penalty=penalty)
        expected = estimator(image, mask)

        wide = torch.zeros(3, 3, 14, 28, dtype=torch.float64)
        wide[..., ::2] = image
        layouts = {
            "channels_last": image.contiguous(memory_format=torch.channels_last),
            "every second column": wide[..., ::2],
            "transposed": image.mT.contiguous().mT,
            "batch last": image.permute(1, 2, 3, 0).contiguous().permute(3, 0, 1, 2),
            "a view into a larger tensor": torch.cat([wide[..., 1::2], image])[3:],
        }
        for layout, values in layouts.items():
            assert torch.equal(values, image), layout
            found = estimator(values, mask.mT.contiguous().mT)
            for field, tensor in tensors(expected):
                assert torch.equal(dict(tensors(found))[field], tensor), (layout, field)

    @each_penalty
    def test_one_photograph_many_times_without_a_copy(self, penalty):
        case = CASES["ordinary"]()
        estimator = estimator_of(case, penalty=penalty)
        alone, found = estimator(case.image), estimator(case.image.expand(4, -1, -1, -1))
        for i in range(4):
            assert torch.equal(alone.class_index, found.class_index[i])
            if penalty == "auto":
                assert difference(alone.weights, found.weights[i]) < 1e-9
            else:
                assert (moved(alone, found[i]) <= another_order(case, penalty)).all()

    @each_penalty
    def test_basis_images_in_float64_or_another_layout(self, penalty):
        case = CASES["ordinary"]()
        expected = estimate(case, penalty=penalty)
        double = replace(case.basis, packed=case.basis.packed.double())
        strided = replace(case.basis, packed=case.basis.packed.permute(2, 0, 1).contiguous().permute(1, 2, 0))
        for basis in (double, strided):
            found = estimate(replace(case, basis=basis), penalty=penalty)
            assert difference(expected.image, found.image) < 1e-6
            if penalty != 0:
                assert weight_change(expected, found) < 1e-6


class TestGradients:
    """Derivatives of tiny cases against finite differences."""

    @staticmethod
    def tiny(name: str) -> Case:
        """Six basis BRDFs in classes of 3, 2 and 1 on 16 pixels."""
        case = CASES[name]()
        rows = [0, 3, 7, 10, 13, 32]
        at = torch.nonzero(case.basis.mask.ravel()).ravel()
        picked = at
        if case.mask is not None:
            picked = picked[case.basis.pack(case.mask)[0]]
        picked = picked[:: max(1, len(picked) // 16)][:16]
        mask = torch.ones(1, 1, len(picked), dtype=torch.bool)
        columns = torch.searchsorted(at, picked.contiguous())
        basis = BasisImages(case.basis.packed[rows][..., columns], mask, ("m0", "m1"), "L", probe="P", view="V")
        return Case(basis, classes_of((0, 1, 0, 2, 1, 0)), case.image.flatten(1)[:, picked][:, None])

    @each_method
    @pytest.mark.parametrize(
        "name",
        ["ordinary", "ten_pixels", "uniform_light", "one_texel", "black_channel", "saturated", "negative_channel",
         "coloured_light_in_the_basis_only"],
    )  # fmt: skip
    def test_gradcheck(self, name: str, method: dict[str, Any]):
        """A black channel is no evidence for "auto", and any light in it is: a jump, so it is left out of the check."""
        case = self.tiny(name)
        solved = estimator_of(case, **method)
        lit = torch.tensor([s for s in range(3) if method["penalty"] != "auto" or case.image[s].any()])
        dark = case.image.clone()

        def outputs(channels: Tensor) -> tuple[Tensor, ...]:
            result = solved(dark.index_copy(0, lit, channels))
            return result.weights, result.class_weights, result.class_errors, result.relative_error, result.image

        image = case.image[lit].clone().requires_grad_()
        assert torch.autograd.gradcheck(outputs, image, atol=1e-5, rtol=1e-3, fast_mode=True)


def resident() -> int:
    """Bytes of this process in memory, freed ones given back first: a leak must not hide in what others left."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


class TestRepeatedCalls:
    @pytest.fixture
    def smallest(self) -> tuple[BRDFEstimator, Tensor, Tensor]:
        case = TestGradients.tiny("ordinary")
        images = case.image + torch.arange(10).view(10, 1, 1, 1) / 100
        masks = torch.rand(5_000, 1, 1, images.shape[-1], generator=torch.Generator().manual_seed(0)) < 0.8
        estimator = BRDFEstimator(case.basis, classes_of((0,) * 6))
        return estimator, images, masks

    @pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="reads /proc/self/statm, needs glibc's malloc_trim")
    def test_thousands_of_calls_need_no_more_memory(self, smallest):
        """Every fifth with another mask, every tenth with a gradient. 128 bytes a call would show."""
        estimator, images, masks = smallest

        def call(i: int) -> None:
            image = images[i % 10]
            if i % 10 == 0:
                image = image.clone().requires_grad_()
                estimator(image).weights.sum().backward()
            else:
                estimator(image, masks[i] if i % 5 == 1 else None)

        for i in range(500):
            call(i)
        before = resident()
        for i in range(500, 2_500):
            call(i)
        assert resident() - before < 2.5e5

    def test_no_python_object_stays(self, smallest):
        estimator, images, masks = smallest

        def calls() -> None:
            for i in range(100):
                estimator(images[i % 10], masks[i] if i % 2 else None)
            gc.collect()

        calls()
        tracemalloc.start()
        calls()
        before, _ = tracemalloc.get_traced_memory()
        calls()
        calls()
        after, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert after - before < 10_000


class TestTransforms:
    @pytest.mark.parametrize("penalty", [DEFAULT, "paper"])
    def test_compile(self, penalty):
        """With graph breaks; the backend does not matter to them, and "eager" needs no C++ compiler."""
        case = CASES["ordinary"]()
        estimator = estimator_of(case, penalty=penalty)
        images = photograph(count=2)
        torch.compiler.reset()
        found = torch.compile(estimator, backend="eager")(images)
        assert difference(estimator(images).weights, found.weights) < 1e-9

    @each_penalty
    def test_vmap(self, penalty):
        case = CASES["ordinary"]()
        estimator = estimator_of(case, penalty=penalty)
        images = photograph(count=3)
        with pytest.raises(RuntimeError, match="vmap"):
            torch.func.vmap(lambda image: estimator(image).weights)(images)

    @each_regularised
    def test_func_grad_is_backward(self, penalty):
        case = CASES["ordinary"]()
        estimator = estimator_of(case, penalty=penalty)
        image = case.image.clone().requires_grad_()
        estimator(image).weights.square().sum().backward()
        found = torch.func.grad(lambda image: estimator(image).weights.square().sum())(case.image)
        assert difference(image.grad, found) < 1e-9


class TestProperties:
    def scene(self, seed: int, count: int = 1) -> tuple[Case, Tensor]:
        case = Case(synthetic(size=10, seed=seed), classes_of(), photograph(size=10, seed=seed + 100)[0])
        return case, photograph(size=10, count=count, seed=seed + 100, noise=0.02)

    @quickly
    @given(st.integers(0, 10**6), st.sampled_from(((1,), (2,), (1, 2))), regularised)
    def test_which_way_the_picture_is_turned_does_not_matter(self, seed: int, flipped: tuple[int, ...], penalty):
        case, _ = self.scene(seed)
        turned = case.basis.unpack(case.basis.packed).flip([axis + 1 for axis in flipped])
        basis = replace(case.basis, packed=case.basis.pack(turned))
        assert torch.equal(case.basis.mask.flip(flipped), case.basis.mask)
        image = case.image.flip(flipped)
        one, other = estimate(case, penalty=penalty), estimate(replace(case, basis=basis, image=image), penalty=penalty)
        assert weight_change(one, other) < 1e-6
        assert difference(one.image.flip(flipped), other.image) < 1e-6

    @quickly
    @given(st.integers(0, 10**6), regularised)
    def test_the_order_of_the_materials_does_not_matter(self, seed: int, penalty):
        case, _ = self.scene(seed)
        order = torch.randperm(12, generator=torch.Generator().manual_seed(seed))
        rows = (3 * order[:, None] + torch.arange(3)).ravel()
        names = tuple(case.basis.names[i] for i in order)
        labels = tuple(torch.tensor(LABELS)[rows].tolist())
        classes = classes_of(labels)
        classes.names = names
        other = replace(case, basis=case.basis.subset(names), classes=classes)
        one, other = estimate(case, penalty=penalty), estimate(other, penalty=penalty)
        assert difference(one.weights[rows], other.weights) < 1e-6

    @quickly
    @given(st.integers(0, 10**6), st.permutations([0, 1, 2]), regularised)
    def test_the_order_of_the_channels_does_not_matter(self, seed: int, order: list[int], penalty):
        """Photograph and light channels permuted: so are the columns of the weights."""
        case, _ = self.scene(seed)
        other = replace(case, basis=replace(case.basis, packed=case.basis.packed[:, order]), image=case.image[order])
        one, other = estimate(case, penalty=penalty), estimate(other, penalty=penalty)
        assert difference(one.weights[:, order], other.weights) < 1e-6

    @quickly
    @given(st.integers(0, 10**6), st.integers(2, 6), regularised)
    def test_a_batch_is_a_loop_in_any_order(self, seed: int, count: int, penalty):
        case, images = self.scene(seed, count)
        masks = torch.rand(count, 1, 10, 10, generator=torch.Generator().manual_seed(seed)) < 0.8
        masks[1:] = masks[-1].clone() if seed % 2 else masks[1:]
        order = torch.randperm(count, generator=torch.Generator().manual_seed(seed))
        estimator = estimator_of(case, penalty=penalty)
        batch, shuffled = estimator(images, masks), estimator(images[order], masks[order])
        assert difference(batch.weights[order], shuffled.weights) < 1e-6
        assert torch.equal(batch.class_index[order], shuffled.class_index)
        for i in range(count):
            assert weight_change(batch[i], estimator(images[i], masks[i])) < 1e-6

    @quickly
    @given(st.integers(0, 10**6), st.integers(-26, 26), st.floats(-8, 8), regularised)
    def test_any_scale(self, seed: int, exponent: int, decade: float, penalty):
        case, _ = self.scene(seed)
        one = estimate(case, penalty=penalty)
        assert weight_change(one, estimate(scaled(case, 2.0**exponent), penalty=penalty)) < 1e-6
        assert weight_change(one, estimate(scaled(case, 10**decade), penalty=penalty)) < 1e-3


@pytest.mark.parametrize("solver", ["factored", "lstsq"])
@each_penalty
def test_threads(penalty, solver: str):
    """Large enough that torch shares the work: 100 materials' worth of pixels and a batch.

    Weights for a fixed penalty may differ as those of sums in another order; all else is not so ill-conditioned.
    """
    if penalty == "auto" and solver == "lstsq":
        pytest.skip('"lstsq" is for fixed penalties')
    basis = synthetic(size=32, m=20)
    images = photograph(size=32, count=4)
    classes = classes_of(tuple(i % 3 for i in range(60)))
    if penalty == 0:
        basis = replace(basis, packed=torch.rand(basis.packed.shape, generator=torch.Generator().manual_seed(0)))
    before = torch.get_num_threads()
    try:
        results = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            results.append(BRDFEstimator(basis, classes, penalty=penalty, solver=solver)(images))
    finally:
        torch.set_num_threads(before)
    if penalty != "auto":
        assert (moved(*results) <= another_order(Case(basis, classes, images), penalty)).all()
    for (name, one), (_, two) in zip(*map(tensors, results), strict=True):
        if penalty == "auto" or "weights" not in name:
            assert difference(one.double(), two.double()) < 1e-9, name


class Real:
    """Twelve materials of the embedded library under a probe, and a photograph of a thirteenth."""

    def __init__(self) -> None:
        source = EmbeddedSource()
        chosen = (*range(0, 100, 9), 4)
        source.names = tuple(source.names[i] for i in chosen)
        source.factors = source.factors.subset(columns_of(chosen))
        whole = MaterialLibrary(build_in_memory(source), tuple(range(13)))
        self.library, self.table = whole.without(whole.names[12]), whole.table(whole.names[12])
        self.view = tb.SphereView(16)
        self.classes = MaterialClasses.fit(self.library, 3, 2)
        self.probe = tb.LightProbe.default(32)
        self.basis, self.image = self.under(self.probe)

    @cached_property
    def scaled(self) -> list[tuple[BasisImages, Tensor]]:
        """Under the probe times 2^-26 and 2^26."""
        return [self.under(self.probe.scaled(2.0**exponent)) for exponent in (-26, 26)]

    def under(self, probe: tb.LightProbe) -> tuple[BasisImages, Tensor]:
        basis = tb.render_basis(self.library, probe, self.view, samples=256)
        return basis, tb.render(self.table, probe, self.view, samples=256, seed=1)


@pytest.fixture(scope="module")
def real() -> Real:
    return Real()


def real_light(name: str) -> tb.LightProbe:
    """16 x 32 texels."""
    radiance = torch.ones(3, 16, 32)
    if name == "one texel":
        radiance = torch.zeros(3, 16, 32)
        radiance[:, 5, 20] = 1
    elif name == "sun":
        radiance[:, 5, 20] = 1e6
    elif name == "red":
        radiance[1:] = 0
    elif name == "behind":
        radiance = torch.zeros(3, 16, 32)
        radiance[:, 7:9, :2] = 1e6
    return tb.LightProbe(radiance)


@pytest.fixture(scope="module", params=["uniform", "one texel", "sun", "red", "behind"])
def scene(request: pytest.FixtureRequest, real: Real) -> tuple[BasisImages, Tensor]:
    return real.under(real_light(request.param))


class TestRealLights:
    @each_penalty
    def test_forward_and_backward(self, scene, real: Real, penalty):
        basis, image = scene
        image = image.clone().requires_grad_()
        result = BRDFEstimator(basis, real.classes, penalty=penalty)(image)
        assert_finite(result)
        assert float(result.relative_error.detach()) < 0.3
        backward(result)
        assert torch.isfinite(image.grad).all()

    def test_scale(self, scene, real: Real):
        basis, image = scene
        case = Case(basis, real.classes, image)
        for exponent in (-26, 26):
            assert weight_change(estimate(case), estimate(scaled(case, 2.0**exponent))) < 1e-6


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
class TestCuda:
    @each_regularised
    @each_case
    def test_agrees_with_the_cpu(self, name: str, penalty):
        case = CASES[name]()
        expected = estimate(case, penalty=penalty)
        mask = None if case.mask is None else case.mask.cuda()
        found = estimator_of(case, penalty=penalty).to("cuda")(case.image.cuda(), mask)
        assert found.weights.is_cuda
        for field in ("weights", "class_errors", "image"):
            assert difference(getattr(expected, field), getattr(found, field).cpu()) < 1e-5, field
