"""Linear radiance on a screen."""

from math import pi

import pytest
import torch

from torchbrdf.images.display import tone_map, with_rim
from torchbrdf.view.sphere import SphereView


def test_tone_map_is_gamma_2_2_clipped():
    values = torch.tensor([-1.0, 0.0, 0.25, 0.5, 1.0, 7.0, torch.nan, torch.inf])
    expected = torch.tensor([0.0, 0.0, 0.532521, 0.729740, 1.0, 1.0, 0.0, 1.0])
    torch.testing.assert_close(tone_map(values), expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(tone_map(values, exposure=2.0)[2], expected[3], atol=1e-5, rtol=0)


def test_a_rim_is_as_bright_as_its_pixels_are_covered():
    """Against means of a finer picture."""
    view, fine = SphereView(40), SphereView(640)
    image = torch.where(view.mask, torch.tensor([0.2, 0.5, 1.0])[:, None, None], 0)
    found = with_rim(image, view.mask, view.coverage)
    within = torch.nn.functional.avg_pool2d((fine.coverage > 0.5).float(), 16)
    torch.testing.assert_close(found, torch.tensor([0.2, 0.5, 1.0])[:, None, None] * within, atol=0.05, rtol=0)
    assert torch.equal(found[:, view.mask[0]], image[:, view.mask[0]])
    assert float(found[:, 0, 0].max()) == 0
    assert float(view.coverage.sum()) * 4 / 40**2 == pytest.approx(pi, rel=1e-3)
