import pytest
import torch

from torchbrdf.images.difference import relative_rms


def test_relative_rms_of_known_images():
    reference = torch.tensor([[[3.0, 4.0], [0.0, 100.0]]])
    image = torch.tensor([[[3.0, 4.5], [0.0, 0.0]]])
    mask = torch.tensor([[[True, True], [True, False]]])
    assert relative_rms(image, reference, mask) == pytest.approx(0.1)
    assert relative_rms(image, reference) == pytest.approx((0.25 + 1e4) ** 0.5 / 10025**0.5)
    assert relative_rms(reference, reference) == 0


def test_bad_images():
    with pytest.raises(ValueError, match=r"images must have equal shapes, got \(3, 2, 2\) and \(3, 2, 3\)"):
        relative_rms(torch.ones(3, 2, 2), torch.ones(3, 2, 3))
    with pytest.raises(ValueError, match="the reference image is 0 in every pixel used"):
        relative_rms(torch.ones(3, 2, 2), torch.zeros(3, 2, 2))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_reference_that_is_not_finite(value: float):
    reference = torch.tensor([[[1.0, value]]])
    with pytest.raises(ValueError, match=r"^the reference image holds NaN or infinite values in pixels used; mask"):
        relative_rms(torch.ones(1, 1, 2), reference)
    assert relative_rms(torch.ones(1, 1, 2), reference, torch.tensor([[True, False]])) == 0
