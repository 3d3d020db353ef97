"""OpenCV's model of a lens: rational radial, tangential and thin-prism distortion [Brown 1966; OpenCV calib3d]."""

from dataclasses import dataclass

import torch
from torch import Tensor

_LENGTHS = (4, 5, 8, 12)
_STEPS = 30
_EXACT = 1e-9


@dataclass(frozen=True)
class Distortion:
    """Of the plane at distance 1 before the camera, x to the right and y down.

    coefficients  k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]]
    Raises ValueError for another number of them, or ones that are not finite.
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the values."""
        given = self.coefficients
        if len(given) not in _LENGTHS or not all(abs(k) < float("inf") for k in given):
            raise ValueError(
                "a lens has 4, 5, 8 or 12 finite coefficients, k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]], got "
                + self._listed
            )

    def __str__(self) -> str:
        """For people."""
        return f"distortion {self._listed}"

    @property
    def _listed(self) -> str:
        return " ".join(f"{k:g}" for k in self.coefficients)

    def apply(self, seen: Tensor) -> Tensor:
        """(..., 2): where the lens shows places (..., 2) that a pinhole sees."""
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (*self.coefficients, *[0.0] * 8)[:12]
        x, y = seen.unbind(-1)
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        beside_x = 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
        beside_y = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4)
        return torch.stack([x * radial + beside_x, y * radial + beside_y], -1)

    def undo(self, shown: Tensor) -> Tensor:
        """The inverse of `apply`, by Newton's method; NaN where there is none that the middle leads to, and of NaN."""
        goal = shown.detach().double().reshape(-1, 2)
        with torch.inference_mode(False), torch.enable_grad():
            goal = goal.clone()  # outside inference mode: of those made within no gradient is found
            seen = goal.clone()
            for _ in range(_STEPS):
                at = seen.clone().requires_grad_()
                value = self.apply(at)
                rows = [torch.autograd.grad(value[:, axis].sum(), at, retain_graph=True)[0] for axis in range(2)]
                slope = torch.stack(rows, 1)
                missing = goal - value.detach()
                if not bool((missing.norm(dim=1) >= _EXACT).any()):
                    break
                step = torch.linalg.solve_ex(slope, missing)[0]
                seen = seen + step * (0.5 / step.norm(dim=1, keepdim=True).clamp_min(0.5))
        found = ((self.apply(seen) - goal).norm(dim=1) <= _EXACT) & (torch.linalg.det(slope) > 0)
        return torch.where(found[:, None], seen, torch.nan).reshape(shown.shape).to(shown.dtype)
