"""The cosines of pairs of directions that isotropic analytic BRDFs are written in."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from torchbrdf.brdf import half_difference

LEAST_COSINE = 1e-6
"""Least cosine: keeps models that divide by it finite at the horizon."""


@dataclass(frozen=True)
class ShadingGeometry:
    """Pairs of directions about a normal; every field is (..., 1), so that parameters of 1 or 3 channels broadcast.

    cos_i, cos_o   cosines to the normal, at least 1e-6, also below the horizon
    cos_h, sin2_h  cosine and squared sine of theta_h; the sine, not from the cosine, is exact near 0
    cos_d          cosine of theta_d: between either direction and the half vector
    above          bool, both directions lie above the horizon
    """

    cos_i: Tensor
    cos_o: Tensor
    cos_h: Tensor
    sin2_h: Tensor
    cos_d: Tensor
    above: Tensor

    @property
    def tan2_h(self) -> Tensor:
        """Squared tangent of theta_h, at most 1e12."""
        return self.sin2_h / self.cos_h.square().clamp_min(LEAST_COSINE**2)

    @property
    def log_cos_h(self) -> Tensor:
        """Logarithm of cos theta_h, at least log 1e-6; exact near theta_h = 0, for high powers of the cosine."""
        near = torch.log1p(-self.sin2_h.clamp_max(0.5)) / 2
        return torch.where(self.sin2_h < 0.5, near, torch.log(self.cos_h.clamp_min(LEAST_COSINE)))

    @property
    def versine_h(self) -> Tensor:
        """1 - cos theta_h, exact near theta_h = 0."""
        return self.sin2_h / (1 + self.cos_h)

    @classmethod
    def of_angles(cls, theta_h: Tensor, theta_d: Tensor, phi_d: Tensor) -> "ShadingGeometry":
        """Of half/difference angles in radians, broadcast against each other to (...), in their precision."""
        angles = torch.broadcast_tensors(theta_h, theta_d, phi_d)
        theta_h, theta_d, phi_d = (angle[..., None] for angle in angles)
        base = torch.cos(theta_d) * torch.cos(theta_h)
        swing = torch.sin(theta_d) * torch.sin(theta_h) * torch.cos(phi_d)
        return cls._of(base - swing, base + swing, theta_h, theta_d)

    @classmethod
    def of_directions(cls, w_i: Tensor, w_o: Tensor) -> "ShadingGeometry":
        """Of unit vectors (..., 3) in the local frame (normal +Z)."""
        theta_h, theta_d, _ = (angle[..., None] for angle in half_difference(w_i, w_o))
        return cls._of(w_i[..., 2:], w_o[..., 2:], theta_h, theta_d)

    @classmethod
    def _of(cls, cos_i: Tensor, cos_o: Tensor, theta_h: Tensor, theta_d: Tensor) -> "ShadingGeometry":
        return cls(
            cos_i=cos_i.clamp_min(LEAST_COSINE),
            cos_o=cos_o.clamp_min(LEAST_COSINE),
            cos_h=torch.cos(theta_h),
            sin2_h=torch.sin(theta_h).square(),
            cos_d=torch.cos(theta_d),
            above=(cos_i > 0) & (cos_o > 0),
        )

    def to(self, dtype: torch.dtype) -> "ShadingGeometry":
        """The same in another precision."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return ShadingGeometry(**{name: v if v.dtype == torch.bool else v.to(dtype) for name, v in values.items()})
