"""Sheets of labelled pictures: tiles in rows, blocks of rows under one another, nothing clipped.

A tile is one screen pixel a pixel. The margin at the left is as wide as the widest label, and titles and captions are
broken into lines that fit their tile, so a sheet of any materials and probes can be read.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

import torchbrdf as tb
from torchbrdf.files import writing
from torchbrdf.images import DISPLAY_GAMMA, tone_map

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GAP, _PAD = 8, 4
_FONT, _LINE = 10, 16
_DPI = 100
_MARK = "#d55e00"
_SUBPIXELS = 8
_PROFILE_RANGE = (-0.45, 1.08)


@dataclass(frozen=True)
class Tile:
    """A picture (3, T, T) of display values, what is written under it, and whether a frame marks it."""

    picture: Tensor
    caption: str = ""
    marked: bool = False


@dataclass(frozen=True)
class Profile:
    """A plot, as wide as a tile and half as high: radiance (T,) along a line, and of the reference in grey.

    Drawn as display values, on which negative radiance keeps its sign: -|y|^(1/2.2).
    """

    radiance: Tensor
    reference: Tensor


Cell = Tile | Profile | None


@dataclass(frozen=True)
class Row:
    """Cells with a label at the left; None is an empty place."""

    label: str
    cells: Sequence[Cell]


@dataclass(frozen=True)
class Block:
    """Rows with a title at the left, turned upright, and a title over each column (none: empty)."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Row]


def sphere_tile(image: Tensor, exposure: float = 1.0) -> Tensor:
    """(3, T, T) display values of a SphereView(T) on white, its silhouette smooth."""
    grown, cover = continued(image)
    return torch.lerp(torch.ones(()), tone_map(grown, exposure), cover)


def continued(image: Tensor) -> tuple[Tensor, Tensor]:
    """An image (3, T, T) of a SphereView(T) up to its silhouette, and the share (1, T, T) of each pixel that is inside.

    Pixels that the silhouette cuts hold no radiance; they continue their neighbours.
    """
    size = image.shape[-1]
    mask, cover = tb.SphereView(size).mask, _coverage(size)
    grown, known = torch.where(mask, image, 0), mask.float()
    while bool((known[cover > 0] == 0).any()):
        share = avg_pool2d(known, 3, 1, 1)
        spread = avg_pool2d(grown, 3, 1, 1) / share.clamp_min(1e-6)
        grown, known = torch.where(known > 0, grown, spread), (share > 0).float()
    return grown, cover


def _coverage(size: int) -> Tensor:
    """(1, size, size): the share of each pixel that the inscribed disc covers."""
    n = size * _SUBPIXELS
    x = (torch.arange(n) + 0.5) * (2 / n) - 1
    return avg_pool2d((x.square() + x[:, None].square() <= 1).float()[None], _SUBPIXELS)


def enlarged(tile: Tensor, size: int) -> Tensor:
    """(3, size, size): a picture of fewer pixels, each of which can be seen."""
    return interpolate(tile[None], (size, size), mode="nearest-exact")[0]


def photograph_tile(image: Tensor, size: int, exposure: float = 1.0) -> Tensor:
    """(3, size, size) display values of a whole photograph (3, N, N)."""
    shown = interpolate(tone_map(image, exposure)[None].float(), (size, size), mode="bilinear", antialias=True)
    return shown[0].clamp(0, 1)


def middle_line(image: Tensor) -> Tensor:
    """(T,): mean of the channels along the horizontal line through the middle of an image (3, T, T)."""
    half = image.shape[-2] // 2
    return image[:, half - 1 : half + 1].mean((0, 1))


@dataclass(frozen=True)
class Sheet:
    """Blocks of rows of tiles of one size."""

    blocks: Sequence[Block]

    @cached_property
    def tile(self) -> int:
        """Pixels along a side of the tiles."""
        cells = [cell for block in self.blocks for row in block.rows for cell in row.cells]
        return next(cell.picture.shape[-1] for cell in cells if isinstance(cell, Tile))

    def write(self, path: Path) -> None:
        """Write a PNG, whole or not at all."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from PIL import Image

        canvas = FigureCanvasAgg(self.figure())
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # without alpha the files are a tenth smaller
        with writing(path) as temporary:
            Image.fromarray(pixels).save(temporary, "PNG", optimize=True)

    def figure(self) -> "Figure":
        """The sheet as matplotlib draws it."""
        ruler = _Ruler()
        fitted = [self._fitted(block, ruler) for block in self.blocks]
        labels = [row.label for block in fitted for row in block.rows]
        title_width = 2 * _PAD + (_LINE if any(block.title for block in fitted) else 0)
        left = title_width + max(map(ruler.width, labels)) + 2 * _PAD
        columns = max(len(row.cells) for block in fitted for row in block.rows)
        width = left + columns * (self.tile + _GAP)
        height = sum(map(self._height, fitted)) + _PAD
        page = _Page(width, height)
        top = _PAD
        for block in fitted:
            self._draw(page, block, left, top)
            top += self._height(block)
        return page.figure

    def _fitted(self, block: Block, ruler: "_Ruler") -> Block:
        """The block with titles and captions broken into lines."""
        width = self.tile + _GAP - 2
        rows = []
        for row in block.rows:
            cells = [
                Tile(cell.picture, ruler.broken(cell.caption, width), cell.marked) if isinstance(cell, Tile) else cell
                for cell in row.cells
            ]
            rows.append(Row(row.label, cells))
        return Block(block.title, [ruler.broken(title, width) for title in block.columns], rows)

    def _head(self, block: Block) -> int:
        return _lines(block.columns) * _LINE + (_PAD if any(block.columns) else 0)

    def _extent(self, row: Row) -> tuple[int, int]:
        """Heights of the cells and of the captions under them."""
        cells = self.tile if any(isinstance(cell, Tile) for cell in row.cells) else self.tile // 2
        captions = _lines([cell.caption for cell in row.cells if isinstance(cell, Tile)])
        return cells, captions * _LINE + _PAD + (_PAD if captions else 0)

    def _height(self, block: Block) -> int:
        return self._head(block) + sum(sum(self._extent(row)) for row in block.rows) + 2 * _GAP

    def _draw(self, page: "_Page", block: Block, left: int, top: int) -> None:
        head = self._head(block)
        middles = [left + j * (self.tile + _GAP) + self.tile / 2 for j in range(len(block.columns))]
        for title, x in zip(block.columns, middles, strict=True):
            page.text(x, top + head - 2 * _PAD, title, ha="center", va="baseline", weight="bold")
        inside = self._height(block) - head - 2 * _GAP
        middle = top + head + inside / 2
        page.text(_PAD + _LINE / 2, middle, block.title, rotation=90, ha="center", va="center", weight="bold")
        y = top + head
        for row in block.rows:
            cell_height, below = self._extent(row)
            page.text(left - 2 * _PAD, y + cell_height / 2, row.label, ha="right", va="center")
            for j, cell in enumerate(row.cells):
                x = left + j * (self.tile + _GAP)
                if isinstance(cell, Tile):
                    page.picture(x, y, cell)
                    caption_top = y + self.tile + _PAD / 2
                    weight = "bold" if cell.marked else "normal"
                    page.text(x + self.tile / 2, caption_top, cell.caption, ha="center", va="top", weight=weight)
                elif isinstance(cell, Profile):
                    page.profile(x, y, self.tile, cell_height, cell)
            y += cell_height + below


def _lines(texts: Sequence[str]) -> int:
    return max((text.count("\n") + 1 for text in texts if text), default=0)


class _Ruler:
    """How wide texts are."""

    def __init__(self) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.font_manager import FontProperties

        self._renderer = FigureCanvasAgg(Figure(dpi=_DPI)).get_renderer()
        self._font = FontProperties(size=_FONT, weight="bold")

    def width(self, text: str) -> int:
        """Of the widest line, in bold, in pixels."""
        measure = self._renderer.get_text_width_height_descent
        return round(max(measure(line, self._font, False)[0] for line in text.split("\n")) + 0.5)

    def broken(self, text: str, width: int) -> str:
        """The text with line breaks after hyphens, underscores and spaces where a line would be too wide."""
        lines = []
        for given in text.split("\n"):
            line = ""
            for part in re.findall(r"[^-_ ]*[-_ ]|[^-_ ]+", given):
                if line and self.width((line + part).rstrip()) > width:
                    lines.append(line.rstrip())
                    line = ""
                line += part
            lines.append(line)
        return "\n".join(lines)


class _Page:
    """A figure on which things are placed in pixels from its top left corner."""

    def __init__(self, width: int, height: int) -> None:
        from matplotlib.figure import Figure

        self._size = width, height
        self.figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)

    def text(self, x: float, y: float, text: str, **style: Any) -> None:
        width, height = self._size
        self.figure.text(x / width, 1 - y / height, text, fontsize=_FONT, linespacing=1.1, **style)

    def picture(self, x: int, y: int, tile: Tile) -> None:
        from matplotlib.patches import Rectangle

        width, height = self._size
        side = tile.picture.shape[-1]
        pixels = (tile.picture.permute(1, 2, 0).clamp(0, 1).numpy() * 255).round().astype(np.uint8)
        self.figure.figimage(pixels, x, height - y - side, origin="upper")
        if tile.marked:
            corner, extent = (x / width, 1 - (y + side) / height), (side / width, side / height)
            self.figure.add_artist(Rectangle(corner, *extent, fill=False, edgecolor=_MARK, linewidth=2))

    def profile(self, x: float, y: float, across: int, down: int, profile: Profile) -> None:
        width, height = self._size
        axes = self.figure.add_axes((x / width, 1 - (y + down) / height, across / width, down / height))
        axes.set(xlim=(0, len(profile.radiance)), ylim=_PROFILE_RANGE, xticks=[], yticks=[])
        axes.axhline(0, color="0.8", linewidth=0.6)
        places = np.arange(len(profile.radiance)) + 0.5
        axes.plot(places, _signed_display(profile.reference), color="0.6", linewidth=2.4)
        axes.plot(places, _signed_display(profile.radiance), color=_MARK, linewidth=0.9)
        for spine in axes.spines.values():
            spine.set_color("0.8")


def _signed_display(radiance: Tensor) -> np.ndarray:
    return (radiance.sign() * radiance.abs().clamp_max(1) ** (1 / DISPLAY_GAMMA)).numpy()
