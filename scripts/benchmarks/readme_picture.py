#!/usr/bin/env python3
"""The picture of the README: photographs of four measured materials, and their BRDFs under a light they never saw.

    torchbrdf precompute
    python scripts/benchmarks/readme_picture.py --measured ../shared/data/rgl

Photographs and truths are rendered by Mitsuba from the files of the RGL database, photographs with noise of 1 % of each
pixel. Each material is recovered by the embedded library without its family, as `torchbrdf fit` does it. Writes
docs/figures/recovered.png.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

import torchbrdf as tb
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import (
    common_exposure,
    default_probes,
    on_white,
    open_probes,
    relatives,
    without_relatives,
)
from torchbrdf.files import writing
from torchbrdf.images import relative_rms
from torchbrdf.mitsuba_backend import MitsubaScene

MATERIALS = ("acrylic_felt_pink", "vch_golden_yellow", "ilm_solo_m_68", "cm_toxic_green")
OBSERVED, NOVEL = "forest", "grace"
TITLES = ("photograph", "recovered", "recovered,\nnew light", "truth,\nnew light")
NOISE = 0.01
TILE = 150
SIZE = 2 * TILE
"""Pixels along a side of what is shown and of what is rendered, photographs too."""

_AT_ONCE = 2
"""Materials in a row of the sheet."""


def write(path: Path, rows: list[list[Tensor]]) -> None:
    """Tiles of four a material at one screen pixel a pixel, _AT_ONCE materials in a row."""
    gap, between, top, left = 8, 30, 44, 26
    group = len(TITLES) * (TILE + gap) - gap
    width = left + _AT_ONCE * (group + between) - between
    height = top + len(rows) // _AT_ONCE * (TILE + gap)
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    for i, (name, tiles) in enumerate(zip(MATERIALS, rows, strict=True)):
        row, column = divmod(i, _AT_ONCE)
        x, y = left + column * (group + between), height - top - row * (TILE + gap) - TILE
        for j, tile in enumerate(tiles):
            pixels = (tile.permute(1, 2, 0).clamp(0, 1).numpy() * 255).round().astype(np.uint8)
            figure.figimage(pixels, x + j * (TILE + gap), y, origin="upper")
            if row == 0:
                middle = (x + j * (TILE + gap) + TILE / 2) / width
                figure.text(middle, 1 - 0.5 * top / height, TITLES[j], ha="center", va="center", fontsize=9)
        figure.text((x - 13) / width, (y + TILE / 2) / height, name, rotation=90, ha="center", va="center", fontsize=8)
    with writing(path) as temporary:
        figure.savefig(temporary, dpi=100, format="png")


def run(options: argparse.Namespace) -> None:
    """Recover, render and write the picture; print the errors."""
    probes = open_probes([path for path in default_probes() if path.stem in (OBSERVED, NOVEL)])
    whole, view = tb.MaterialLibrary.default(), tb.SphereView(SIZE)
    basis = tb.render_basis(whole, probes[OBSERVED], view, progress=True)
    rows = []
    for seed, name in enumerate(MATERIALS):
        bsdf = {"type": "measured", "filename": str(options.measured / f"{name}_rgb.bsdf")}
        scenes = (MitsubaScene(view, probes[light], bsdf) for light in (OBSERVED, NOVEL))
        clean, truth = (scene.render(1024).clamp_min(0) for scene in scenes)
        noise = torch.randn(clean.shape, generator=torch.Generator().manual_seed(seed))
        photograph = clean * (1 + NOISE * noise)
        dropped = relatives(name, whole.names)
        library = without_relatives(whole, name)
        classes = tb.MaterialClasses.fit(library)
        estimate = tb.BRDFEstimator(basis.without(*dropped), classes, constraint="lobes", library=library)
        table = estimate(photograph).brdf(library)
        known, novel = (tb.render(table, probes[light], view) for light in (OBSERVED, NOVEL))
        print(f"{name}: {100 * relative_rms(novel.double(), truth.double(), view.mask):.1f} % under the new light")
        here, there = common_exposure([clean]), common_exposure([truth])
        tiles = [on_white(photograph, view.mask, here), on_white(known, view.mask, here)]
        tiles += [on_white(image, view.mask, there) for image in (novel, truth)]
        rows.append([torch.nn.functional.avg_pool2d(tile, SIZE // TILE) for tile in tiles])
    write(options.output, rows)


def main() -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--measured", type=Path, required=True, help="folder of the database's files")
    default = Path(__file__).resolve().parents[2] / "docs" / "figures" / "recovered.png"
    parser.add_argument("-o", "--output", type=Path, default=default)
    return exit_status("readme_picture", run, parser.parse_args(), "interrupted")


if __name__ == "__main__":
    sys.exit(main())
