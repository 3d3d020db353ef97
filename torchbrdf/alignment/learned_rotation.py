"""The light's rotation as a parameter to be trained, for pipelines in which it is one unknown of several.

`align` finds it faster where nothing else is unknown. Imports kornia, so `import torchbrdf` does not import it.
"""

import torch
from kornia.geometry.liegroup import So3
from torch import Tensor, nn

from torchbrdf.lasting import without_autocast
from torchbrdf.light import checked_rotation
from torchbrdf.transport.harmonic import HarmonicBasis


class LearnedRotation(nn.Module):
    """Images of a material under a light whose rotation is learned: exp(turn) times a start, on the group SO(3).

    light     basis images in any orientation
    rotation  (3, 3) to start from, of `Alignment.rotation` for example; None for none
    The parameter `turn` (3,) float32 is in radians about +X, +Y and +Z; optimisers of any kind take it. Gradients also
    flow to the weights, and to the probe's radiance where it requires them.
    Raises ValueError where rotation is none.
    """

    start: Tensor

    def __init__(self, light: HarmonicBasis, rotation: Tensor | None = None) -> None:
        """Start without a turn."""
        super().__init__()
        self.light = light
        start = torch.eye(3, dtype=torch.float32) if rotation is None else checked_rotation(rotation).float()
        self.register_buffer("start", start)
        self.turn = nn.Parameter(torch.zeros(3, dtype=torch.float32))

    @property
    @without_autocast
    def rotation(self) -> Tensor:
        """(3, 3): as `LightProbe.rotated` takes it, differentiable."""
        return So3.exp(self.turn[None]).matrix()[0] @ self.start

    def forward(self, weights: Tensor) -> Tensor:
        """(3, P): Y w over the pixels of the view, for weights (n, 3)."""
        return self.light.image_at(weights, self.rotation)
