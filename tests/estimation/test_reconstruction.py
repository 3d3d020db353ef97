"""Results that are kept, saved and printed."""

import pickle

import pytest
import torch

import torchbrdf as tb
from torchbrdf.brdf import MaterialLibrary


@pytest.fixture(scope="module")
def basis(tiny_library: MaterialLibrary) -> tb.BasisImages:
    return tb.render_basis(tiny_library, tb.LightProbe.default(32), tb.SphereView(12), samples=64)


@pytest.fixture(scope="module")
def estimator(tiny_library: MaterialLibrary, basis: tb.BasisImages) -> tb.BRDFEstimator:
    return tb.BRDFEstimator(basis, tb.MaterialClasses.fit(tiny_library, 2, 2))


def photographs(basis: tb.BasisImages) -> torch.Tensor:
    return torch.stack([basis.image(name) for name in ("white", "gold-0.3")])


@pytest.mark.parametrize("settings", [{}, {"penalty": 0.1, "constraint": "nonnegative"}], ids=["averaged", "fixed"])
@pytest.mark.parametrize("several", [False, True], ids=["one photograph", "several"])
def test_detached_tensors_are_the_same_without_gradients(
    basis: tb.BasisImages, estimator: tb.BRDFEstimator, settings: dict, several: bool
):
    made = tb.BRDFEstimator([basis, basis] if several else basis, estimator.classes, **settings)
    images = photographs(basis).requires_grad_()
    result = made([images, 2 * images] if several else images)
    detached = result.detach()
    assert result.weights.requires_grad
    pairs = [(value, getattr(detached, name)) for name, value in vars(result).items()]
    pairs += list(zip(*pairs.pop([a is result.image for a, _ in pairs].index(True)), strict=True)) if several else []
    for before, after in pairs:
        if isinstance(before, torch.Tensor):
            assert torch.equal(before, after)
            assert not after.requires_grad
        else:
            assert before is after


def test_without_posteriors_a_result_is_small_and_says_what_is_gone(
    tiny_library: MaterialLibrary, basis: tb.BasisImages, estimator: tb.BRDFEstimator
):
    result = estimator(photographs(basis))
    kept = result.without_posteriors()
    whole, small = (len(pickle.dumps(one)) for one in (result, kept))
    tensors = [value for value in vars(kept).values() if isinstance(value, torch.Tensor)]
    size = sum(one.numel() * one.element_size() for one in tensors)
    assert small < size + 10_000 < whole / 5
    again = pickle.loads(pickle.dumps(kept))
    assert torch.equal(again[1].weights, result[1].weights)
    assert torch.equal(again[1].brdf(tiny_library).values, result[1].brdf(tiny_library).values)
    gone = r"^this result is one without_posteriors\(\): ask the result from which that was made$"
    for ask in (lambda: again[1].posterior, lambda: again[1].image_std(basis), lambda: again[1].brdf_std(tiny_library)):
        with pytest.raises(ValueError, match=gone):
            ask()
    assert result[1].posterior.moments.mean.shape == (3, tiny_library.n)


def test_on_another_device_it_is_without_posteriors(basis: tb.BasisImages, estimator: tb.BRDFEstimator):
    result = estimator(photographs(basis))
    here, there = result.to("cpu"), result.to("meta")
    assert here.posteriors is result.posteriors
    assert there.image.device == there.class_index.device == torch.device("meta")
    with pytest.raises(ValueError, match="without_posteriors"):
        there[0].posterior  # noqa: B018


def test_with_a_fixed_penalty_there_is_nothing_to_leave_out(basis: tb.BasisImages, estimator: tb.BRDFEstimator):
    result = tb.BRDFEstimator(basis, estimator.classes, penalty=0.1)(photographs(basis))
    assert result.without_posteriors() is result


def test_what_is_printed_is_short(basis: tb.BasisImages, estimator: tb.BRDFEstimator):
    result = estimator(photographs(basis))
    one, n = result[0], basis.n
    assert repr(result.posteriors) == "PosteriorBatch(2 photographs)"
    assert repr(one.posteriors) == "PosteriorBatch(1 photograph)"
    assert repr(one.without_posteriors().posteriors) == "PosteriorBatch(1 photograph, left out)"
    assert repr(one.posterior.moments) == f"Moments(mean (3, {n}), covariance (3, {n}, {n}))"
    priors, penalties = one.posterior.probabilities.shape
    expected = f"Explanation(2 photographs, {priors} priors, {penalties} penalties each)"
    assert repr(one.posterior.explanation) == expected
    assert len(f"{one.posterior!r} {one!r}") < 200
