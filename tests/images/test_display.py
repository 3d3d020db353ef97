"""Linear radiance on a screen."""

import torch

from torchbrdf.images.display import tone_map


def test_tone_map_is_gamma_2_2_clipped():
    values = torch.tensor([-1.0, 0.0, 0.25, 0.5, 1.0, 7.0, torch.nan, torch.inf])
    expected = torch.tensor([0.0, 0.0, 0.532521, 0.729740, 1.0, 1.0, 0.0, 1.0])
    torch.testing.assert_close(tone_map(values), expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(tone_map(values, exposure=2.0)[2], expected[3], atol=1e-5, rtol=0)
