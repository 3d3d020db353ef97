"""Pictures of the whole sphere on the faces of a cube, which are seen from inside."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.light.latlong import area_mean
from torchbrdf.light.layouts._supersampling import lookups

_AXES = {f"{sign}{axis}": (k, value) for k, axis in enumerate("XYZ") for sign, value in (("+", 1.0), ("-", -1.0))}

Cell = tuple[int, int]
"""Column and row of a face."""


@dataclass(frozen=True)
class Face:
    """A face of the cube in a picture.

    towards   the axis that its middle shows, such as "-Z"
    right     that at its right edge; down: that at its bottom edge
    """

    towards: str
    right: str
    down: str


FORWARD = Face("-Z", "+X", "-Y")
RIGHT = Face("+X", "+Z", "-Y")
BACK = Face("+Z", "-X", "-Y")
LEFT = Face("-X", "-Z", "-Y")
UP = Face("+Y", "+X", "-Z")
DOWN = Face("-Y", "+X", "+Z")


@dataclass(frozen=True)
class CubeLayout:
    """Where in the picture the faces are.

    faces      the six, by their cells
    to_edges   pixels at the rim of a face stand on its edges, not half a pixel inside
    """

    faces: Mapping[Cell, Face]
    to_edges: bool = False

    @property
    def cells(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        columns, rows = zip(*self.faces, strict=True)
        return max(rows) + 1, max(columns) + 1

    def placed(self, size: tuple[int, int], circle: object, what: str) -> "Cube":
        """The faces in a picture of so many rows and columns. Raises ValueError where its proportions are others."""
        rows, columns = self.cells
        side = size[0] // rows
        if size != (rows * side, columns * side) or side < 2:
            raise ValueError(f"{what} must be {rows} faces high and {columns} wide, got {size[0]} x {size[1]} pixels")
        return Cube(self, side)


@dataclass(frozen=True)
class Cube:
    """The faces of a cube in a picture, and how many pixels along a side they are."""

    layout: CubeLayout
    side: int

    @property
    def rows(self) -> int:
        """Of a lat-long map about as fine."""
        return 2 * self.side

    @property
    def description(self) -> str:
        """In words, for people."""
        return f"faces of {self.side} x {self.side} pixels"

    def weights(self, margin: float = 0.0) -> Tensor:
        """(H, W) float64: the pixels' solid angles up to a factor; 0 between the faces."""
        n = self.side
        at = torch.arange(n, dtype=torch.float64)
        at = 2 * at / (n - 1) - 1 if self.layout.to_edges else (2 * at + 1) / n - 1
        face = (1 + at[:, None] ** 2 + at[None, :] ** 2) ** -1.5
        rows, columns = self.layout.cells
        weights = torch.zeros(rows * n, columns * n, dtype=torch.float64)
        for column, row in self.layout.faces:
            weights[row * n : (row + 1) * n, column * n : (column + 1) * n] = face
        return weights

    def to_latlong(self, image: Tensor, height: int) -> Tensor:
        """The lat-long map (channels, height, 2 height) of the picture (channels, H, W): area means of its pixels."""
        n = self.side
        texels = image.flatten(1).t().contiguous()
        frames = torch.zeros(3, 6, 3, device=image.device, dtype=torch.float32)  # right, down and towards of each face
        corners = []
        for k, ((column, row), face) in enumerate(self.layout.faces.items()):
            for j, name in enumerate((face.right, face.down, face.towards)):
                axis, sign = _AXES[name]
                frames[j, k, axis] = sign
            corners.append(row * n * image.shape[2] + column * n)
        first = torch.tensor(corners, device=image.device)

        def pixel(position: Tensor) -> Tensor:
            """Of a position from -1 to 1 along a face."""
            along = (position + 1) / 2
            along = along * (n - 1) + 0.5 if self.layout.to_edges else along * n
            return along.floor().clamp(0, n - 1).long()

        def radiance_of(directions: Tensor) -> Tensor:
            right, down, towards = (directions @ axes.t() for axes in frames)
            depth, face = towards.max(dim=-1, keepdim=True)
            column, row = (pixel(along.gather(-1, face) / depth) for along in (right, down))
            return texels[(first[face] + row * image.shape[2] + column).squeeze(-1)]

        return area_mean(radiance_of, height, 2 * height, lookups(self.rows, height), image.device)
