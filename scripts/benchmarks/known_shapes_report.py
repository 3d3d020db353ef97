"""Tables and pictures of scripts/benchmarks/known_shapes.py: [CBP21, fig. 6], and error against the normals shown."""

import statistics
from collections.abc import Mapping, Sequence
from math import pi
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

import torchbrdf as tb
from known_shapes_scenes import Judgement
from torchbrdf.images import tone_map
from torchbrdf.rendering import render_tables

LIGHTS = (0, 136)
"""Directional lights in degrees, as the paper's; see torchbrdf.rendering.directional."""

_TILE = 150
_SUPERSAMPLING = 3
_SAMPLES = 128
_GAP = 6


def display_size() -> int:
    """Pixels along a side of the renderings that become tiles."""
    return _TILE * _SUPERSAMPLING


def on_white(image: Tensor, mask: Tensor, exposure: float = 1.0) -> Tensor:
    """(3, TILE, TILE) display values of a rendering (3, display_size, display_size).

    Pixels that a silhouette cuts are outside the mask, also where one part of the shape hides another; they
    continue their neighbours, so that no light lines remain.
    """
    share = avg_pool2d(mask.float(), 3, 1, 1)
    grown = avg_pool2d(torch.where(mask, image, 0), 3, 1, 1) / share.clamp_min(1e-6)
    shown = tone_map(torch.where(mask, image, grown), exposure)
    return avg_pool2d(torch.where(share > 0, shown, 1.0), _SUPERSAMPLING)


def exposure_of(image: Tensor, mask: Tensor) -> float:
    """What brings nineteen twentieths of the pixels below 0.8 of white."""
    return float(0.8 / torch.quantile(image.amax(0)[mask[0]], 0.95))


def observations(tables: Sequence[tb.MerlTable], probe: tb.LightProbe, views: Sequence[tb.View]) -> list[list[Tensor]]:
    """Tiles, one row a material: each view under the probe. The exposure of a row is that of its first view."""
    rows: list[list[Tensor]] = [[] for _ in tables]
    exposures = [0.0] * len(tables)
    for view in views:
        for i, image in enumerate(render_tables(tables, probe, view, _SAMPLES, seed=3)):
            exposures[i] = exposures[i] or exposure_of(image, view.mask)
            rows[i].append(on_white(image, view.mask, exposures[i]))
    return rows


def lit_spheres(tables: Sequence[tb.MerlTable], angle_deg: float) -> list[Tensor]:
    """Tiles: a sphere of each table under a directional light in which a white Lambertian surface would be 1."""
    view = tb.SphereView(display_size())
    return [
        on_white(tb.render_directional(table, view, angle_deg, irradiance=pi, subpixels=2), view.mask)
        for table in tables
    ]


def write_grid(
    path: Path, titles: Sequence[str], blocks: Mapping[str, Mapping[str, Sequence[Tensor | None]]], dpi: int = 100
) -> None:
    """Write blocks of rows of tiles, one screen pixel a pixel.

    blocks  material -> label of the row -> tiles (3, TILE, TILE), None for an empty place
    """
    from matplotlib.figure import Figure

    n_rows = sum(len(rows) for rows in blocks.values())
    left, top, between = 96, 26, 14
    width = left + len(titles) * (_TILE + _GAP)
    height = top + n_rows * (_TILE + _GAP) + between * (len(blocks) - 1)
    figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi)
    y = height - top
    for material, rows in blocks.items():
        block_top = y
        for label, tiles in rows.items():
            y -= _TILE + _GAP
            for j, tile in enumerate(tiles):
                if tile is not None:
                    pixels = (tile.permute(1, 2, 0).clamp(0, 1).numpy() * 255).round().astype(np.uint8)
                    figure.figimage(pixels, left + j * (_TILE + _GAP), y, origin="upper")
            figure.text(
                62 / width, (y + _TILE / 2) / height, label, rotation=90, ha="center", va="center", fontsize=8
            )
        middle = (block_top + y) / 2 / height
        figure.text(22 / width, middle, material, rotation=90, ha="center", va="center", fontsize=10, weight="bold")
        y -= between
    for j, title in enumerate(titles):
        x = (left + j * (_TILE + _GAP) + _TILE / 2) / width
        figure.text(x, 1 - 0.5 * top / height, title, ha="center", va="center", fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)


def probe_tile(probe: tb.LightProbe) -> Tensor:
    """A tile with the light probe in its middle."""
    small = interpolate(probe.radiance[None], (_TILE // 2, _TILE), mode="area")[0]
    tile = torch.ones(3, _TILE, _TILE)
    start = _TILE // 4
    tile[:, start : start + _TILE // 2] = tone_map(small, float(0.6 / small.amax(0).quantile(0.9)))
    return tile


def write_scatter(path: Path, coverage: Mapping[str, float], errors: Mapping[str, float], threshold: float) -> None:
    """Write a plot of novel-light errors in per cent against the share of normals, with the names of the shapes."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    figure = Figure(figsize=(8, 5), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    axes.axvline(threshold, color="0.7", linestyle="--", label=f"a warning below {threshold:g}")
    for shape, x in coverage.items():
        short = shape.replace(" degrees", "°").removeprefix("cap of ")
        right = shape.startswith(("plane", "cube", "sphere"))
        axes.plot(x, errors[shape], "o", color="C1" if shape.startswith("cap") else "C0", markersize=5)
        place = (7, -3) if right else (-5, -9)
        axes.annotate(
            short, (x, errors[shape]), place, textcoords="offset points", fontsize=8, ha="left" if right else "right"
        )
    axes.plot([], [], "o", color="C1", markersize=5, label="caps of a sphere, angle from the middle to the edge")
    axes.set(xscale="log", yscale="log", xlabel="normal_coverage: share of the normals of a sphere")
    axes.set_xlim(right=1.9)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    axes.set_ylabel("error under novel light, mean [%]")
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)


def print_judgements(
    materials: Sequence[str], judgements: Mapping[str, Mapping[str, Judgement]], what: str = "shape"
) -> None:
    """A table of observation / novel errors, with means over the materials."""
    rows = []
    for name, by_material in judgements.items():
        pairs = [(100 * found.observation, 100 * found.novel) for found in by_material.values()]
        pairs.append((statistics.mean(pair[0] for pair in pairs), statistics.mean(pair[1] for pair in pairs)))
        rows.append((name, *(f"{observation:.2f} / {novel:.2f}" for observation, novel in pairs)))
    print_table((what, *materials, "mean"), rows)


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table in Markdown."""
    print("| " + " | ".join(header) + " |")
    print("|---" + "|---:" * (len(header) - 1) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
