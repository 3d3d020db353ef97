#!/usr/bin/env python3
"""Tables of materials that no one measured: rough metals, and coats of varnish over diffuse bases and over metals.

    python scripts/unmeasured_tables.py -o FOLDER

Metals are GGX microfacets with the Fresnel factors of n and k that Mitsuba ships; a coat is a rough dielectric of index
1.5, what it lets in and out and a base below, without what is reflected between the two. A library that holds them
beside measured tables tells whether they earn their place (docs/default_library.md).
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from math import pi
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

from torchbrdf.analytic.fresnel import dielectric
from torchbrdf.analytic.microfacet import ggx_distribution, ggx_visibility
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.brdf import GRID, TABLE_SUFFIX, MerlTable, above_horizon, cell_centres
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.light.mirror import Metal

METALS = ("Ag", "Al", "Au", "Cr", "Cu", "Hg", "Ir", "Li", "Mo", "Rh", "TiN", "VN", "W")
ROUGHNESS = (0.05, 0.12, 0.3)
COATS = (0.02, 0.06, 0.15, 0.3)
ALBEDOS = ((0.03, 0.1, 0.3), (0.5, 0.7, 0.9))
"""Of diffuse bases under a coat, a channel each: channels are basis BRDFs by themselves."""

UNDER_COATS = ("Al", "Au", "Cu")
INDEX = torch.tensor(1.5, dtype=torch.float64)


def lobe(geometry: ShadingGeometry, alpha: float) -> Tensor:
    """D G / (4 cos theta_i cos theta_o) of GGX."""
    roughness = torch.tensor(alpha, dtype=torch.float64)
    return ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)


def metal(geometry: ShadingGeometry, name: str, alpha: float) -> Tensor:
    """A rough conductor."""
    return lobe(geometry, alpha) * Metal.open(name).reflectance(torch.acos(geometry.cos_d[..., 0].clamp(0, 1)))


def coated(geometry: ShadingGeometry, base: Tensor, alpha: float) -> Tensor:
    """A rough dielectric coat over a base."""
    passed = (1 - dielectric(geometry.cos_i, INDEX)) * (1 - dielectric(geometry.cos_o, INDEX))
    return lobe(geometry, alpha) * dielectric(geometry.cos_d, INDEX) + passed * base


def materials(geometry: ShadingGeometry) -> Iterator[tuple[str, Tensor]]:
    """Names, and f_r (N, 3)."""
    for name in METALS:
        for alpha in ROUGHNESS:
            yield f"metal-{name}-{alpha:g}", metal(geometry, name, alpha)
    for alpha in COATS:
        for albedos in ALBEDOS:
            base = torch.tensor(albedos, dtype=torch.float64) / pi
            yield f"coat-{alpha:g}-diffuse-{albedos[0]:g}", coated(geometry, base, alpha)
        for name in UNDER_COATS:
            yield f"coat-{alpha:g}-{name}", coated(geometry, metal(geometry, name, ROUGHNESS[-1]), alpha)


def run(options: argparse.Namespace) -> None:
    options.output.mkdir(parents=True, exist_ok=True)
    valid = above_horizon()
    geometry = ShadingGeometry.of_angles(*(angle.expand(GRID)[valid] for angle in cell_centres()))
    count = len(METALS) * len(ROUGHNESS) + len(COATS) * (len(ALBEDOS) + len(UNDER_COATS))
    for name, f_r in tqdm(materials(geometry), total=count, leave=False):
        values = torch.zeros(*GRID, 3, dtype=torch.float64)
        values[valid] = f_r
        MerlTable(values, valid, name).save(options.output / f"{name}{TABLE_SUFFIX}")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the tables")
    return exit_status("unmeasured_tables", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
