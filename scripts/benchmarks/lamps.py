#!/usr/bin/env python3
"""How well `tb.align` finds the radiance of a clipped sun, on measured materials: the tables of docs/alignment.md.

    python scripts/benchmarks/lamps.py --library merl -o OUT
    python scripts/benchmarks/lamps.py --library merl --clipped 1 --turned 0 1 -o OUT

A sun of 0.53 degrees is added to a probe, as 1 to 5 times the irradiance of all the rest. Mitsuba renders a sphere of
each material under both, with 1 % noise. What `align` is given is clipped at the sun's radiance over 2 to 1000, and
turned; it is told neither. A probe that is clipped by 1 is as it was, and what is found of it is false. The factor is
that of the clipped texels' power, weighed by luminance; deviations are in the posterior's standard deviations.

OUT holds the renderings: run the same command again to go on with them.
"""

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from math import cos, degrees, pi, radians
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize

import torchbrdf as tb
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import SHARED, markdown_table, noisy_observations, without_relatives
from torchbrdf.images import luminance, read_image
from torchbrdf.light import rotation_angle, rotation_of
from torchbrdf.mitsuba_backend import MitsubaScene

SUNS = {
    "uffizi.hdr": ((0.5, 0.6, 0.62), 3.0),
    "venice.exr": ((-0.6, 0.3, 0.74), 1.5),
    "apartment.exr": ((0.3, 0.75, -0.2), 5.0),
    "forest.exr": ((-0.2, 0.5, 0.84), 2.0),
    "dawn.exr": ((0.85, 0.25, 0.3), 1.0),
}
"""Direction towards the sun, and its irradiance in units of pi times the mean radiance of all the rest."""

COLOUR = (1.0, 0.9, 0.72)
GLOSSY = ("cg_sunflower", "ilm_solo_m_68", "aurora_white", "vch_golden_yellow")
MATTE = ("acrylic_felt_pink", "satin_purple", "leaf_maple", "colodur_connemara_4c")
_RADIUS = radians(0.265)
_ROWS = 512


def areas(height: int) -> Tensor:
    """(height, 1): solid angles of texels that cover cells."""
    edges = torch.arange(height + 1, dtype=torch.float64) * (pi / height)
    return (torch.cos(edges).diff().neg() * (pi / height))[:, None]


def sun_of(rest: Tensor, direction: Sequence[float], ratio: float) -> Tensor:
    """(3, h, w): a disc, as means over the texels."""
    height, parts = rest.shape[1], 8
    steps = (torch.arange(height * parts, dtype=torch.float64) + 0.5) * (pi / height / parts)
    across = (torch.arange(2 * height * parts, dtype=torch.float64) + 0.5) * (pi / height / parts)
    x, y, z = normalize(torch.tensor(direction, dtype=torch.float64), dim=0)
    toward = torch.sin(steps)[:, None] * (torch.sin(across) * x - torch.cos(across) * z) + torch.cos(steps)[:, None] * y
    cover = (toward > cos(_RADIUS)).double().view(height, parts, 2 * height, parts).mean((1, 3))
    mean = float((rest.mean(0) * areas(height)).sum() / (4 * pi))
    radiance = ratio * pi * mean / float((cover * areas(height)).sum())
    return (torch.tensor(COLOUR)[:, None, None] * radiance * cover).float()


def opened(picture: Tensor) -> tb.LightProbe:
    """The probe of a file with this picture."""
    with tempfile.TemporaryDirectory() as folder:
        tb.write_image(Path(folder) / "probe.exr", picture)
        return tb.LightProbe.open(Path(folder) / "probe.exr")


def rendered(path: Path, picture: Tensor, material: Path, samples: int) -> Tensor:
    """The sphere in a file, rendered where there is none."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        bsdf = {"type": "measured", "filename": str(material)}
        tb.write_image(path, MitsubaScene(tb.SphereView(64), opened(picture), bsdf).render(samples, 1))
    return read_image(path).clamp_min(0)


def case(
    photo: Tensor, true: Tensor, given: Tensor, turned: float, key: int, library: tb.MaterialLibrary
) -> dict[str, Any]:
    """What `align` makes of a photograph (3, N, N) under a picture of light, given another."""
    axis = normalize(torch.randn(3, generator=torch.Generator().manual_seed(key), dtype=torch.float64), dim=0)
    rotation = rotation_of(radians(turned) * axis)
    probe = opened(given)
    probe = probe.rotated(rotation.T) if turned else probe
    started, cpu = time.perf_counter(), time.process_time()
    found = tb.align(photo, probe, tb.SphereView(photo.shape[-1]), library)
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    row = {"left": degrees(rotation_angle(found.rotation @ rotation.T)), "seconds": seconds, "cpu": cpu}
    if found.lamp is None:
        return row | {"lamp": False}
    ceiling = given >= 0.999 * given.amax((1, 2), keepdim=True)
    power, held = ((picture * ceiling * areas(len(given[0]))).sum((1, 2)) for picture in (true, given))
    got = luminance((held * found.lamp.factors)[:, None, None]) / luminance(power[:, None, None])
    off = (found.lamp.factors * held / power).log().abs() / found.lamp.std.clamp_min(1e-6)
    return row | {
        "lamp": True,
        "factor": float(luminance(power[:, None, None]) / luminance(held[:, None, None])),
        "ratio": float(got),
        "channels": (found.lamp.factors * held / power).tolist(),
        "std": float(found.lamp.std.max()),
        "deviations": float(off.max()),
        "clipped": found.lamp.clipped,
        "log_odds": found.lamp.log_odds,
    }


def run(options: argparse.Namespace) -> int:
    warnings.simplefilter("ignore", UserWarning)
    library = tb.MaterialLibrary.from_files(options.library or "default")
    rows: list[Mapping[str, Any]] = []
    for name in options.probes:
        rest = read_image(SHARED / "probes" / name).clamp_min(0)
        finer = max(1, _ROWS // rest.shape[1])
        rest = rest.repeat_interleave(finer, 1).repeat_interleave(finer, 2)
        sun = sun_of(rest, *SUNS[name])
        for material in options.materials:
            stem = options.output / Path(name).stem / material
            bsdf = SHARED / "rgl" / f"{material}_rgb.bsdf"
            parts = ((rest, "base", 1024), (sun, "sun", 512))
            images = [rendered(Path(f"{stem}_{kind}.exr"), light, bsdf, n) for light, kind, n in parts]
            image = torch.stack(images).sum(0)
            noisy = noisy_observations(image, [1.0], f"{name} {material}")[0].float()
            for clipped in options.clipped:
                for turned in options.turned:
                    given = (rest + sun).clamp_max(float((rest + sun).max()) / clipped)
                    row = case(noisy, rest + sun, given, turned, len(rows), without_relatives(library, material))
                    rows.append({"probe": Path(name).stem, "material": material, "by": clipped, "turned": turned} | row)
                    print(rows[-1], file=sys.stderr, flush=True)
    print(report(rows))
    return 0


def report(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line for each kind of material and clipping."""
    table = []
    for kind, materials, bound in (("glossy", GLOSSY, 0.1), ("matte", MATTE, 0.3)):
        for by in sorted({row["by"] for row in rows}):
            some = [row for row in rows if row["material"] in materials and row["by"] == by and row["lamp"]]
            if not some:
                continue
            off = sorted(abs(row["ratio"] - 1) for row in some)
            table.append([
                kind, f"{by:g}", str(len(some)), str(sum(row["clipped"] for row in some)),
                f"{100 * off[len(off) // 2]:.0f} %", f"{100 * off[-1]:.0f} %",
                f"{sum(one <= bound for one in off)} within {100 * bound:.0f} %",
                f"{sum(row['deviations'] < 2 for row in some)}", f"{max(row['cpu'] for row in some):.1f}",
            ])  # fmt: skip
    head = "material|clipped by|cases|found clipped|off: median|worst|bar|channels within 2 std|CPU seconds, most"
    return markdown_table(head.split("|"), table)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, help="folder of MERL tables; default: the embedded library")
    parser.add_argument("--probes", nargs="+", choices=tuple(SUNS), default=tuple(SUNS), metavar="FILE")
    parser.add_argument("--materials", nargs="+", choices=GLOSSY + MATTE, default=GLOSSY + MATTE, metavar="NAME")
    parser.add_argument("--clipped", nargs="+", type=float, default=(2, 10, 100, 1000), metavar="X")
    parser.add_argument("--turned", nargs="+", type=float, default=(1,), metavar="DEG")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the renderings")
    return exit_status("lamps", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
