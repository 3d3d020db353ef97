"""The pictures of the gallery: balls on nothing, so that they stand on a page of any colour."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import avg_pool2d

from paper.figures.sheet import continued
from torchbrdf.files import writing
from torchbrdf.images import tone_map

SUPERSAMPLING = 2
"""Pixels of a rendering along a side of one of a picture."""

_QUALITY, _OVERVIEW_QUALITY = 98, 90
_GRAIN = 0.8
"""Standard deviation, in steps of 8 bits, of noise that keeps smooth shading from falling into bands."""

_GAP = 8
_OVERVIEW_COLUMNS, _OVERVIEW_TILE = 12, 116


def ball(image: Tensor, exposure: float) -> Tensor:
    """(4, T, T) display values and opacity of radiance (3, 2 T, 2 T) of a `SphereView`, its rim smooth."""
    grown, cover = continued(image)
    opacity = avg_pool2d(cover, SUPERSAMPLING)
    colour = avg_pool2d(tone_map(grown, exposure) * cover, SUPERSAMPLING)
    return torch.cat([colour / opacity.clamp_min(1e-6), opacity])


def side_by_side(balls: Sequence[Tensor]) -> Tensor:
    """(4, T, W): pictures (4, T, T) beside one another with nothing between."""
    gap = torch.zeros(4, balls[0].shape[-2], _GAP)
    pieces = [piece for picture in balls for piece in (gap, picture)]
    return torch.cat(pieces[1:], dim=-1)


def write_picture(path: Path, picture: Tensor, quality: int = _QUALITY) -> None:
    """Write (4, H, W) display values and opacity as WebP, whole or not at all."""
    grain = torch.randn(picture.shape[1:], generator=torch.Generator().manual_seed(0))
    steps = 255 * picture + _GRAIN * torch.cat([grain.expand(3, -1, -1), torch.zeros_like(grain)[None]])
    pixels = steps.permute(1, 2, 0).clamp(0, 255).round().to(torch.uint8).numpy()
    encoded = io.BytesIO()
    Image.fromarray(pixels, "RGBA").save(encoded, "WEBP", quality=quality, method=6, use_sharp_yuv=True)
    with writing(path) as temporary:
        temporary.write_bytes(encoded.getvalue())


def write_overview(path: Path, tiles: Sequence[Path]) -> None:
    """Write one picture of the balls at the left of some tiles, row by row."""
    rows = -(-len(tiles) // _OVERVIEW_COLUMNS)
    step = _OVERVIEW_TILE + _GAP
    sheet = np.zeros((rows * step - _GAP, min(len(tiles), _OVERVIEW_COLUMNS) * step - _GAP, 4), np.uint8)
    for i, tile in enumerate(tiles):
        with Image.open(tile) as opened:
            side = opened.height
            small = opened.convert("RGBA").crop((0, 0, side, side)).resize((_OVERVIEW_TILE,) * 2, Image.Resampling.BOX)
        y, x = (step * place for place in divmod(i, _OVERVIEW_COLUMNS))
        sheet[y : y + _OVERVIEW_TILE, x : x + _OVERVIEW_TILE] = np.asarray(small)
    write_picture(path, torch.from_numpy(sheet).permute(2, 0, 1) / 255, _OVERVIEW_QUALITY)
