"""What gets in front of a photographed ball: discs, torn shapes, hands. Masks of them and a training augmentation."""

from collections.abc import Mapping, Sequence
from math import pi
from typing import Any

import torch
from torch import Tensor

from torchbrdf.learning.hiding import HidingAugmentation, Range, check_range

KINDS = ("ellipse", "polygon", "hand")

_CORNERS = 9
_HAND = (
    # x and y of both ends, radius: the palm has unit size, the fingers point along +x, the arm comes from -x
    (-0.25, 0.0, 0.25, 0.0, 0.62),
    (0.55, 0.48, 1.45, 0.62, 0.17),
    (0.65, 0.16, 1.75, 0.2, 0.18),
    (0.65, -0.16, 1.65, -0.2, 0.18),
    (0.55, -0.46, 1.3, -0.6, 0.15),
    (-0.1, 0.5, 0.75, 1.15, 0.2),
    (-0.3, 0.0, -9.0, 0.0, 0.48),
)


def draw_occluders(kind: Tensor, centre: Tensor, size: Tensor, angle: Tensor, corners: Tensor, grid: Tensor) -> Tensor:
    """Where shapes lie.

    kind     (*batch,)     int64, into KINDS
    centre   (*batch, 2)   x to the right and y up; the image is [-1, 1] along its longer side
    size     (*batch,)     half axis of an ellipse, largest radius of a polygon, half of a palm; 0 is nowhere
    angle    (*batch,)     radians, against the clock
    corners  (*batch, V)   0 to 1: distances of a polygon's corners from its centre; the first is the short axis of an
                           ellipse, too
    grid     (2, H, W)     x and y of the centres of the pixels, see `pixel_grid`
    returns  (*batch, H, W) bool, True where a shape covers the centre of the pixel
    """
    batch, size_of_grid = kind.shape, grid.shape[-2:]
    kind, centre, size, angle, corners = (
        one.reshape(-1, *one.shape[len(batch) :]) for one in (kind, centre, size, angle, corners)
    )
    covered = torch.zeros(len(kind), *size_of_grid, dtype=torch.bool, device=grid.device)
    for which, inside in enumerate((_in_ellipse, _in_polygon, _in_hand)):
        rows = torch.nonzero((kind == which) & (size > 0)).ravel()
        x, y = (grid - centre[rows, :, None, None]).unbind(1)
        cosine, sine, scale = (one[rows, None, None] for one in (torch.cos(angle), torch.sin(angle), size))
        x, y = (cosine * x + sine * y) / scale, (cosine * y - sine * x) / scale
        covered[rows] = inside(x, y, corners[rows])
    return covered.reshape(*batch, *size_of_grid)


def pixel_grid(height: int, width: int, device: torch.device | str = "cpu") -> Tensor:
    """(2, H, W): x and y of the centres of the pixels, y up, [-1, 1] from edge to edge of the longer side."""
    longer = max(height, width)
    x = (2 * torch.arange(width, dtype=torch.float32, device=device) + 1 - width) / longer
    y = (height - 1 - 2 * torch.arange(height, dtype=torch.float32, device=device)) / longer
    return torch.stack(torch.meshgrid(x, y, indexing="xy"))


class RandomOccluders(HidingAugmentation):
    """Random objects in front of the ball, of random colours, shaded from one side to the other.

    count     least and largest number
    size      least and largest, see `draw_occluders`; 1 is half of the image
    kinds     which of KINDS to draw from
    radiance  least and largest radiance, in mean radiances of the image; even in its logarithm, tinted by a third
    known     whether masks lose what is hidden; else a network or a robust estimator has to find out
    """

    def __init__(
        self,
        count: tuple[int, int] = (1, 2),
        size: Range = (0.1, 0.4),
        kinds: Sequence[str] = KINDS,
        radiance: Range = (0.1, 3.0),
        known: bool = False,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
    ) -> None:
        """Check the ranges and the kinds."""
        strange = [kind for kind in kinds if kind not in KINDS]
        if strange or not kinds:
            raise ValueError(f"kinds must be some of {', '.join(KINDS)}, got {tuple(kinds)}")
        super().__init__(
            known,
            same_on_batch,
            p,
            keepdim,
            count=tuple(map(int, check_range(count, "count", 0))),
            size=check_range(size, "size", 1e-3),
            kinds=tuple(kinds),
            radiance=check_range(radiance, "radiance", 1e-6),
        )

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw shapes and colours; those beyond an image's count have size 0 and lie nowhere."""
        least, most = self.flags["count"]
        present = torch.arange(most, device=self.device) < self.uniform(batch_shape, (least, most + 1), 1).floor()
        kinds = torch.tensor([KINDS.index(kind) for kind in self.flags["kinds"]], device=self.device)
        chosen = self.uniform(batch_shape, (0, len(kinds)), most).long().clamp_max(len(kinds) - 1)
        low, high = (float(x) for x in torch.tensor(self.flags["radiance"], dtype=torch.float32).log())
        return {
            "kind": kinds[chosen],
            "centre": self.uniform(batch_shape, (-0.8, 0.8), most, 2),
            "size": self.uniform(batch_shape, self.flags["size"], most) * present,
            "angle": self.uniform(batch_shape, (0, 2 * pi), most),
            "corners": self.uniform(batch_shape, (0.35, 1), most, _CORNERS),
            "radiance": (self.uniform(batch_shape, (low, high), most, 1)
                         + self.uniform(batch_shape, (-0.3, 0.3), most, 3)).exp(),
            "slope": self.uniform(batch_shape, (-0.4, 0.4), most, 2),
        }  # fmt: skip

    def covered(self, shape: Sequence[int], params: Mapping[str, Tensor]) -> Tensor:
        """(B, K, H, W) bool: where each shape lies."""
        grid = pixel_grid(shape[-2], shape[-1], params["size"].device)
        outlines = {name: params[name] for name in ("kind", "centre", "size", "angle", "corners")}
        return draw_occluders(**outlines, grid=grid)

    def kept(self, shape: Sequence[int], params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor:
        """What no shape covers."""
        return ~self.covered(shape, params).any(1, keepdim=True)

    def apply_transform(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Paint the shapes one over the other."""
        grid = pixel_grid(input.shape[-2], input.shape[-1], input.device)
        shade = 1 + torch.einsum("bki,ihw->bkhw", params["slope"].to(input), grid.to(input))
        colours = params["radiance"].to(input) * input.mean((1, 2, 3))[:, None, None]
        painted = input
        for k, covered in enumerate(self.covered(input.shape, params).to(input.device).unbind(1)):
            colour = shade[:, k, None] * colours[:, k, :, None, None]
            painted = torch.where(covered[:, None], colour, painted)
        return painted


def _in_ellipse(x: Tensor, y: Tensor, corners: Tensor) -> Tensor:
    """Inside the ellipse of half axes 1 and the first of corners (N, V); x, y (N, H, W)."""
    return x.square() + (y / corners[:, :1, None]).square() < 1


def _in_polygon(x: Tensor, y: Tensor, corners: Tensor) -> Tensor:
    """Inside the polygon with corners (N, V) at even angles around the origin; x, y (N, H, W)."""
    step = 2 * pi / corners.shape[1]
    angles = step * torch.arange(corners.shape[1], dtype=corners.dtype, device=corners.device)
    x_0, y_0 = corners * torch.cos(angles), corners * torch.sin(angles)
    x_1, y_1 = x_0.roll(-1, 1), y_0.roll(-1, 1)
    sector = torch.remainder(torch.atan2(y, x) / step, corners.shape[1]).long().clamp_max(corners.shape[1] - 1)
    # (p_1 - p_0) x (p - p_0) > 0: left of the edge of the sector that holds p
    edges = (x_1 - x_0, y_1 - y_0, (x_1 - x_0) * y_0 - (y_1 - y_0) * x_0)
    a, b, c = (edge.gather(1, sector.flatten(1)).view_as(x) for edge in edges)
    return a * y - b * x > c


def _in_hand(x: Tensor, y: Tensor, corners: Tensor) -> Tensor:
    """Nearer to a bone of the hand than its radius; x, y (N, H, W)."""
    inside = torch.zeros_like(x, dtype=torch.bool)
    for x_0, y_0, x_1, y_1, radius in _HAND:
        d_x, d_y = x_1 - x_0, y_1 - y_0
        along = (((x - x_0) * d_x + (y - y_0) * d_y) / (d_x * d_x + d_y * d_y)).clamp(0, 1)
        inside |= (x - x_0 - along * d_x).square() + (y - y_0 - along * d_y).square() < radius * radius
    return inside
