"""Errors that neighbouring pixels share."""

import torch

from torchbrdf.estimation.smooth_errors import REACH, SIZE, smooth_errors
from torchbrdf.view import SphereView

DISC = SphereView(24).mask


def places(mask: torch.Tensor) -> torch.Tensor:
    return (torch.nonzero(mask[0]).double() + 0.5) / 12 - 1


def test_covariance_is_a_gaussian_of_the_distance():
    errors = smooth_errors([DISC])
    expected = SIZE**2 * torch.exp(-torch.cdist(places(DISC), places(DISC)).square() / (2 * REACH**2))
    assert float((errors @ errors.mT - expected).norm() / expected.norm()) < 0.07  # what the series leaves out
    assert errors.shape[1] == 10


def test_size_on_the_picture_and_place_in_it_do_not_matter():
    small = torch.zeros(1, 100, 80, dtype=torch.bool)
    small[:, 60:84, 5:29] = DISC
    assert torch.equal(smooth_errors([small]), smooth_errors([DISC]))


def test_photographs_share_none():
    other = SphereView(16).mask
    both = smooth_errors([DISC, other])
    pixels = int(DISC.sum())
    assert torch.equal(both[:pixels, :10], smooth_errors([DISC]))
    assert torch.equal(both[pixels:, 10:], smooth_errors([other]))
    assert not both[:pixels, 10:].any()
    assert not both[pixels:, :10].any()


def test_one_pixel():
    alone = torch.ones(1, 1, 1, dtype=torch.bool)
    assert torch.isfinite(smooth_errors([alone])).all()


