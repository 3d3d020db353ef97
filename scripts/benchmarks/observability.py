#!/usr/bin/env python3
"""Claim: the verdict on a light, made before any photograph, foretells the error under other light.

    python scripts/benchmarks/observability.py --library merl

Lights: the probes, torchbrdf's own room, a constant, a vertical gradient, one texel before and one behind the object,
and the first probe mixed with the constant, share by share. Under each, every `step`-th material of the library is left
out, photographed with 1 % noise (rendered with other random numbers than the basis), and the result rendered under the
probes: the error is the mean of |rendered - truth| / |truth| over those other than the light itself.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from calibration import whole_without
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.estimation.observability import observability
from torchbrdf.experiments import default_probes, markdown_table, noisy_observations, open_probes, without_relatives

SHARES = (0.3, 0.1, 0.03, 0.01)
"""Of the first probe's mean radiance in the mixtures with uniform light."""


Pair = tuple[tb.BasisImages, tb.BasisImages]
"""Basis images under one light, twice with different random numbers."""


def artificial(height: int = 32) -> dict[str, tb.LightProbe]:
    """A constant, a gradient from above to below, one texel on the camera's side and one behind the object."""
    constant = torch.ones(3, height, 2 * height)
    lights = {"uniform": constant, "gradient": constant * torch.linspace(2, 0.01, height)[:, None]}
    for name, row, column in (
        ("lamp in front", 3 * height // 8, 15 * height // 16),
        ("lamp behind", height // 4, height // 4),
    ):
        lights[name] = torch.zeros_like(constant)
        lights[name][:, row, column] = 1
    return {name: tb.LightProbe(radiance) for name, radiance in lights.items()}


def mixed(one: tb.BasisImages, other: tb.BasisImages, share: float) -> tb.BasisImages:
    """Basis images under `share` of one light and the rest of another, at equal brightness."""
    level = other.packed.mean() / one.packed.mean()
    return replace(one, packed=share * level * one.packed + (1 - share) * other.packed, probe=f"{share} {one.probe}")


def novel_error(
    name: str,
    light: Pair,
    probes: dict[str, Pair],
    library: tb.MaterialLibrary,
    classes: tb.MaterialClasses,
    step: int,
) -> float:
    """Mean over left-out materials and probes other than the light; pairs are basis images and independent ones."""
    errors: list[Tensor] = []
    for material in library.names[::step]:
        less = without_relatives(library, material)
        estimator = tb.BRDFEstimator(light[0].subset(less.names), whole_without(classes, less))
        packed = noisy_observations(light[1].pack(light[1].image(material)).double(), [1.0], f"{material} {name}")
        weights = estimator(light[0].unpack(packed[0])).weights
        for other, (basis, again) in probes.items():
            if other not in name:
                shown, truth = basis.subset(less.names).render(weights), again.image(material).double()
                errors.append((shown - truth).norm() / truth.norm())
    return float(torch.stack(errors).mean())


def run(options: argparse.Namespace) -> None:
    """Render, judge and compare."""
    folder = options.library
    library = tb.MaterialLibrary.from_files(folder or "default")
    probes = open_probes(options.probes or default_probes())
    view, classes = tb.SphereView(options.size), tb.MaterialClasses.fit(library)
    rendered: dict[str, Pair] = {}
    every = {**probes, "room": tb.LightProbe.default(), **artificial()}
    for name, light in tqdm(every.items(), desc="basis", leave=False):
        rendered[name] = tb.render_basis(library, light, view), tb.render_basis(library, light, view, seed=77)
    first = next(iter(probes))
    lights = dict(rendered)
    for share in SHARES:
        one, other = rendered[first], rendered["uniform"]
        lights[f"{share:.0%} {first}, rest uniform"] = mixed(one[0], other[0], share), mixed(one[1], other[1], share)
    rows = []
    for name, pair in tqdm(lights.items(), desc="lights", leave=False):
        found = observability(tb.BRDFEstimator(pair[0], classes).bank, classes)
        error = novel_error(name, pair, {key: rendered[key] for key in probes}, library, classes, options.step)
        freedom = ", ".join(f"{one:.0f}" for one in found.freedom)
        verdict = found.verdict.split(":")[0]
        rows.append([name, freedom, f"{found.whole:.0f}", f"{found.highlight:.2f}", f"{100 * error:.1f}", verdict])
    rows.sort(key=lambda row: float(row[3]))
    head = ["light", "freedom of the classes", "of the library", "highlight", "novel error, %", "verdict"]
    print(markdown_table(head, rows))


def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, help="folder of MERL *.binary tables; default: the embedded library")
    parser.add_argument("--probes", nargs="+", type=Path, metavar="FILE", help="default: 7 of ../shared/data/probes")
    parser.add_argument("--step", type=int, default=8, help="every so many materials")
    parser.add_argument("--size", type=int, default=64, help="pixels along a side")
    return exit_status("observability", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
