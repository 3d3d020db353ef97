"""Sheets of pictures: rows of spheres with names."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.files import writing
from torchbrdf.images import tone_map


def common_exposure(images: Sequence[Tensor]) -> float:
    """What brings the brighter pixels of some images, of which a twentieth is brighter still, to nearly white."""
    values = torch.cat([image.amax(0)[image.amax(0) > 0].ravel() for image in images])
    return float(0.8 / torch.quantile(values, 0.95))


def write_sheet(path: Path, rows: Mapping[str, Sequence[Tensor]], titles: Sequence[str], tile: int) -> None:
    """Write a PNG of pictures in rows with names.

    rows    name -> display values (3, N, N) in [0, 1], one for each title
    tile    pixels along a side of a picture; N is enlarged or reduced to it
    """
    from matplotlib.figure import Figure

    gap, top, left = 6, 36, 140
    width, height = left + len(titles) * (tile + gap), top + len(rows) * (tile + gap)
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    for i, (name, pictures) in enumerate(rows.items()):
        y = height - top - (i + 1) * tile - i * gap
        for j, picture in enumerate(pictures):
            resize = torch.nn.functional.interpolate
            shown = resize(picture[None].float(), (tile, tile), mode="bilinear", antialias=True)
            pixels = (shown[0].permute(1, 2, 0).clamp(0, 1).numpy() * 255).round().astype(np.uint8)
            figure.figimage(pixels, left + j * (tile + gap), y, origin="upper")
        figure.text((left - 6) / width, (y + tile / 2) / height, name, ha="right", va="center", fontsize=7)
    for j, title in enumerate(titles):
        x = (left + j * (tile + gap) + tile / 2) / width
        figure.text(x, 1 - 0.5 * top / height, title, ha="center", va="center", fontsize=7)
    with writing(path) as temporary:
        figure.savefig(temporary, dpi=100)


def on_white(image: Tensor, mask: Tensor, scale: float) -> Tensor:
    """(3, N, N) display values of radiance, white outside the mask (1, N, N)."""
    return torch.where(mask, tone_map(image, scale), 1.0)
