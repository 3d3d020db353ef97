"""What a seed draws, whatever torch's default type is."""

import torch
from kornia.augmentation import AugmentationBase2D
from torch import Tensor


class DrawnInFloat32(AugmentationBase2D):
    """An augmentation that draws in float32 to which images it is applied: kornia draws in torch's default type."""

    def __batch_prob_generator__(
        self, batch_shape: tuple[int, ...], p: float, p_batch: float, same_on_batch: bool
    ) -> Tensor:
        """(B,): 1 for images to which it is applied, 0 for the others."""
        if p in (0, 1):
            return super().__batch_prob_generator__(batch_shape, p, p_batch, same_on_batch)
        drawn = torch.rand(1 if same_on_batch else batch_shape[0], device=self.device, dtype=torch.float32)
        return (drawn < p).to(self.dtype).expand(batch_shape[0])
