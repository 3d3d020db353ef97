"""How far the picture of an analytic BRDF is from a photograph, or from another picture.

    sum |(Y - y) / (y + mean(y))|^2 / sum |y / (y + mean(y))|^2

over pixels and channels, of a rendering Y and a photograph y: highlights count, and do not count for everything.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.analytic.catalogue import model_of
from torchbrdf.analytic.cell_transport import CellTransport
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.lasting import lasting


@dataclass(frozen=True)
class ImageResiduals:
    """Weighted differences of pixels, whose squares sum to 1 for a black rendering.

    transport
    pixels  (Q,)    which of the view's P pixels are used
    target  (Q, 3)  radiance
    roots   (Q, 3)  weights
    """

    transport: CellTransport
    pixels: Tensor
    target: Tensor
    roots: Tensor

    @classmethod
    @lasting
    def of_image(cls, image: Tensor, transport: CellTransport, mask: Tensor | None = None) -> "ImageResiduals":
        """To a photograph (3, H, W), where the mask (1, H, W) is True."""
        view = transport.view
        used = view.pack(view.mask if mask is None else view.mask & mask)[0]
        target = view.pack(image).T[used].float()
        roots = 1 / (target.clamp_min(0) + target.mean())
        return cls(transport, torch.nonzero(used).ravel(), target, roots / torch.linalg.vector_norm(roots * target))

    @property
    def geometry(self) -> ShadingGeometry:
        """Of the cells that the transport sums."""
        return self.transport.geometry

    def of(self, f_r: Tensor) -> Tensor:
        """(Q, 3) of f_r (M, 3)."""
        return self.roots * (self.transport.render(f_r)[self.pixels] - self.target)

    def error(self, model: str, parameters: Mapping[str, Tensor]) -> float:
        """The root of the sum of their squares for parameters of a model, by its name."""
        return float(torch.linalg.vector_norm(self.of(model_of(model).evaluate(parameters, self.geometry))))

    def along(self, f_r: Tensor, tangents: Tensor) -> Tensor:
        """(S, Q, 3): derivatives along tangents (S, M, 3)."""
        return self.roots * self.transport.render(tangents)[:, self.pixels]
