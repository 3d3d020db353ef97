"""A network with the estimator as a layer, which gives photographs back without their defects."""

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate

from torchbrdf.estimation import BRDFEstimator
from torchbrdf.view import View

DARKEST = 0.02
"""Of the mean radiance: below it the network sees no differences."""


class Restorer(nn.Module):
    """What a photograph would show without its defects, by a small U-Net and the estimator's own renderings.

    estimate  recovers a material from a whole photograph
    view      of the photographs; sides a multiple of 4
    width     channels at full resolution
    rounds    how often gaps are filled anew
    """

    estimate: BRDFEstimator
    place: Tensor
    doubt: Tensor
    """(B, 1, H, W) in [0, 1]: how little each pixel of the last photographs was believed."""

    def __init__(self, estimate: BRDFEstimator, view: View, width: int = 8, rounds: int = 3) -> None:
        """Build the network; it starts by believing every pixel to seven eighths."""
        super().__init__()
        self.estimate, self.rounds = estimate, rounds
        self.register_buffer("place", torch.cat([view.normals, view.mask.float()])[None])
        self.fine, self.middle, self.coarse = _block(10, width), _block(width, 2 * width), _block(2 * width, 4 * width)
        self.up_middle, self.up_fine = _block(6 * width, 2 * width), _block(3 * width, width)
        self.last = nn.Conv2d(width, 4, 1)
        nn.init.zeros_(self.last.weight)
        self.last.bias = nn.Parameter(torch.tensor([-2.0, 0, 0, 0]))

    def forward(self, image: Tensor) -> Tensor:
        """(B, 3, H, W) -> (B, 3, H, W)."""
        with torch.no_grad():
            fitted = self.estimate(image).image
        mask = self.place[:, 3:]
        mean = (image * mask).mean((1, 2, 3), keepdim=True)
        seen, shown = (mask * torch.log((one / mean).clamp_min(0) + DARKEST) for one in (image, fitted))
        fine = self.fine(torch.cat([seen, seen - shown, self.place.expand(len(image), -1, -1, -1)], 1))
        middle = self.middle(avg_pool2d(fine, 2))
        coarse = self.coarse(avg_pool2d(middle, 2))
        middle = self.up_middle(torch.cat([middle, _twice(coarse)], 1))
        doubt, correction = self.last(self.up_fine(torch.cat([fine, _twice(middle)], 1))).split([1, 3], 1)
        self.doubt = doubt.sigmoid()
        corrected, filled = image * mask * correction.exp(), fitted
        for _ in range(self.rounds):
            # A pixel that shows what the estimator says tells it nothing: in the limit doubt is a soft mask.
            filled = self.estimate(torch.lerp(corrected, filled, self.doubt)).image
        return torch.lerp(corrected, filled, self.doubt)


def _block(inputs: int, outputs: int) -> nn.Module:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.GroupNorm(4, outputs),
        nn.SiLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.SiLU(),
    )


def _twice(image: Tensor) -> Tensor:
    return interpolate(image, scale_factor=2.0, mode="bilinear")


def relative(found: Tensor, wanted: Tensor) -> Tensor:
    """(B,): |found - wanted| / |wanted|."""
    return (found - wanted).flatten(1).norm(dim=1) / wanted.flatten(1).norm(dim=1)
