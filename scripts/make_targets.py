#!/usr/bin/env python3
"""Targets that accuracy is measured on: materials that no library holds, rendered by Mitsuba under light probes.

    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/make_targets.py --analytic --probes grace.hdr -o targets_analytic --sheet sheet.png

Every material is put on a sphere under every probe and rendered with light that is reflected once (`direct`).
--measured takes the `.bsdf` files of a folder (Mitsuba's `measured`), --analytic the materials below. Each image is
made in two halves, which tell its Monte Carlo noise; where that exceeds --noise, samples are added until it does
not, or until --max-samples. With --turned each target has its probe turned by a random rotation, which its metadata
hold.

OUT/PROBE/MATERIAL.exr holds the radiance as rendered. Measured materials have colours outside the gamut of RGB, and
such pixels are negative: they stay so in the file, and the metadata say how much of the image they are. A material
whose image holds a NaN or an infinity is refused. Files are whole or absent: interrupted, the same command goes on
where it stopped, and a file is made anew only where its metadata say that something else was asked for.
"""

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.command_line import BAD_INPUT, RESUMABLE, Parser, exit_status, fail
from torchbrdf.experiments import (
    FORMAT,
    Target,
    common_exposure,
    default_probes,
    negative_share,
    on_white,
    open_probes,
    write_sheet,
)
from torchbrdf.images import read_metadata, write_image
from torchbrdf.light import rotation_of
from torchbrdf.mitsuba_backend import HalfRenderings, MitsubaScene
from torchbrdf.mitsuba_startup import load_mitsuba

INTEGRATOR = {"type": "direct"}
SAMPLES = 4096
NOISE = 0.01
MAX_SAMPLES = 1 << 18

_MOST_GROWTH = 4
"""Samples are multiplied by no more at a time: a noise found with few samples may be far off."""


def _rgb(red: float, green: float, blue: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [red, green, blue]}


def _plastic(alpha: float, *diffuse: float) -> dict[str, Any]:
    reflectance = {"diffuse_reflectance": _rgb(*diffuse), "nonlinear": True}
    return {"type": "roughplastic", "distribution": "ggx", "alpha": alpha, **reflectance}


def _metal(material: str, alpha: float) -> dict[str, Any]:
    return {"type": "roughconductor", "distribution": "ggx", "material": material, "alpha": alpha}


def _principled(roughness: float, *base: float, **others: float) -> dict[str, Any]:
    return {"type": "principled", "base_color": _rgb(*base), "roughness": roughness, **others}


ANALYTIC: dict[str, dict[str, Any]] = {
    "white-plaster": _principled(1.0, 0.8, 0.8, 0.8, specular=0.0),
    "terracotta": _principled(0.9, 0.5, 0.2, 0.1, specular=0.2),
    "blue-velvet": _principled(0.9, 0.05, 0.08, 0.35, sheen=1.0, sheen_tint=0.5, specular=0.1),
    "green-satin": _principled(0.45, 0.1, 0.4, 0.12, specular=0.5),
    "violet-metallic": _principled(0.35, 0.35, 0.12, 0.5, metallic=0.8),
    "red-car-paint": _principled(0.5, 0.55, 0.03, 0.02, metallic=0.4, clearcoat=1.0, clearcoat_gloss=0.95),
    "white-plastic": _plastic(0.3, 0.75, 0.75, 0.75),
    "yellow-plastic": _plastic(0.15, 0.7, 0.5, 0.02),
    "blue-billiard": _plastic(0.04, 0.02, 0.05, 0.4),
    "black-plastic": _plastic(0.1, 0.01, 0.01, 0.01),
    "copper-blasted": _metal("Cu", 0.4),
    "aluminium-brushed": _metal("Al", 0.2),
    "gold-polished": _metal("Au", 0.1),
    "chromium-mirror": _metal("Cr", 0.03),
}
"""From diffuse to mirror-like, white and coloured: name -> BSDF as a Mitsuba dictionary."""


@dataclass(frozen=True)
class Material:
    """A BSDF for Mitsuba, and the text that tells it from every other."""

    name: str
    bsdf: Mapping[str, Any]
    identity: str


def measured_materials(folder: Path) -> list[Material]:
    """The `.bsdf` files of a folder. Raises FileNotFoundError where there are none."""
    paths = sorted(folder.glob("*.bsdf"))
    if not paths:
        raise FileNotFoundError(f"{folder}: no .bsdf files here; give a folder of measured materials")
    materials = []
    for path in paths:
        identity = {"type": "measured", "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        bsdf = {"type": "measured", "filename": str(path)}
        materials.append(Material(path.stem, bsdf, json.dumps(identity, sort_keys=True)))
    return materials


def analytic_materials() -> list[Material]:
    """The materials of ANALYTIC."""
    return [Material(name, bsdf, json.dumps(bsdf, sort_keys=True)) for name, bsdf in ANALYTIC.items()]


@dataclass(frozen=True)
class Quality:
    """How targets are rendered.

    samples      a pixel, at first
    noise        relative RMS of the Monte Carlo error above which samples are added
    max_samples  a pixel, after which they are not
    turned       degrees, at most, by which each target's probe is turned about an axis of its own
    """

    size: int = 64
    samples: int = SAMPLES
    noise: float = NOISE
    max_samples: int = MAX_SAMPLES
    seed: int = 0
    turned: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not 2 <= self.samples <= self.max_samples:
            raise ValueError(
                f"samples must be at least 2 and at most max_samples, got {self.samples} and {self.max_samples}"
            )
        if not 0 <= self.turned <= 180:
            raise ValueError(f"probes can be turned by 0 to 180 degrees, got {self.turned}")
        if not self.noise > 0:
            raise ValueError(f"noise must be a positive fraction such as {NOISE}, got {self.noise}")


def render_halves(scene: MitsubaScene, quality: Quality, seed: int) -> tuple[HalfRenderings, int]:
    """Render until the noise is small enough or the samples are spent; returns how many a pixel it took."""
    done = quality.samples // 2 * 2
    halves = scene.render_halves(done, seed)
    while halves.noise > quality.noise and done + 2 <= quality.max_samples:
        factor = min(_MOST_GROWTH, 1.1 * (halves.noise / quality.noise) ** 2)
        more = max(2, (min(math.ceil(done * factor), quality.max_samples) - done) // 2 * 2)
        seed += 1
        extra = scene.render_halves(more, seed)
        share = more / (done + more)
        halves = HalfRenderings(halves.first.lerp(extra.first, share), halves.second.lerp(extra.second, share))
        done += more
    return halves, done


def turn_of(material: Material, probe_name: str, quality: Quality) -> list[list[float]] | None:
    """The rotation of the probe: about a random axis, by an angle drawn from 0 to `quality.turned` degrees."""
    if not quality.turned:
        return None
    generator = torch.Generator().manual_seed(seed_of(quality, material, probe_name, "turn"))
    axis = torch.randn(3, generator=generator, dtype=torch.float64)
    angle = math.radians(quality.turned) * float(torch.rand(1, generator=generator))
    return rotation_of(angle * axis / axis.norm()).tolist()


def seed_of(quality: Quality, material: Material, *what: str) -> int:
    """A number that differs between whatever differs."""
    key = " ".join((str(quality.seed), material.name, *what))
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:6], "little")


def asked_for(material: Material, probe_name: str, probe: tb.LightProbe, quality: Quality) -> dict[str, str]:
    """The metadata that are known before anything is rendered."""
    rotation = turn_of(material, probe_name, quality)
    turned = {} if rotation is None else {"rotation": json.dumps(rotation)}
    return turned | {
        "format": FORMAT,
        "material": material.name,
        "plugin": material.bsdf["type"],
        "bsdf": material.identity,
        "integrator": json.dumps(INTEGRATOR),
        "probe": probe_name,
        "probe_fingerprint": probe.fingerprint,
        "shape": f"sphere, orthographic, {quality.size} x {quality.size} pixels",
        "asked_samples": str(quality.samples),
        "asked_noise": f"{quality.noise:g}",
        "max_samples": str(quality.max_samples),
        "seed": str(quality.seed),
        "renderer": f"mitsuba {load_mitsuba().__version__} {load_mitsuba().variant()}",
    }


def is_there(path: Path, asked: Mapping[str, str]) -> bool:
    """Whether a file holds what is asked for."""
    if not path.exists():
        return False
    try:
        found = read_metadata(path)
    except ValueError:
        return False
    return all(found.get(key) == asked.get(key) for key in {"rotation", *asked})


def make_target(path: Path, material: Material, probe: tb.LightProbe, quality: Quality, asked: dict[str, str]) -> None:
    """Render a target and write it. Raises ValueError where Mitsuba cannot, or the image is black or not finite."""
    seed = seed_of(quality, material, asked["probe"])
    rotation = torch.tensor(json.loads(asked["rotation"])) if "rotation" in asked else None
    try:
        scene = MitsubaScene(tb.SphereView(quality.size), probe, material.bsdf, INTEGRATOR, rotation)
    except RuntimeError as error:
        raise ValueError(f"{material.name}: Mitsuba cannot make this BSDF: {str(error).splitlines()[-1]}") from None
    halves, samples = render_halves(scene, quality, seed)
    image = halves.image
    unsound = int((~torch.isfinite(image)).any(0).sum())
    if unsound or not bool(image.any()):
        what = f"{unsound} pixels that are NaN or infinite" if unsound else "no pixel that is not black"
        raise ValueError(f"{material.name} under {asked['probe']}: the image has {what}; no target was written")
    found = {"samples": str(samples), "noise": f"{halves.noise:.6f}", "negative": f"{negative_share(image):.6f}"}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, image, asked | found)


def make_targets(
    folder: Path, materials: Sequence[Material], probes: Mapping[str, tb.LightProbe], quality: Quality
) -> Iterator[tuple[Path, str | None]]:
    """Make the targets that are not there yet; the files one by one, with what was wrong where there is none."""
    jobs = [(material, name) for name in probes for material in materials]
    with tqdm(total=len(jobs), desc="targets") as bar:
        for material, name in jobs:
            bar.set_postfix_str(f"{material.name}, {name}")
            path = folder / name / f"{material.name}.exr"
            asked = asked_for(material, name, probes[name], quality)
            problem = None
            if not is_there(path, asked):
                try:
                    make_target(path, material, probes[name], quality, asked)
                except ValueError as error:
                    problem = str(error)
            bar.update()
            yield path, problem


def describe(targets: Sequence[Target], noise: float) -> str:
    """A Markdown table of samples, noise and negative share by material, and what missed the noise asked for."""
    head = "| material | plugin | samples a pixel | noise: mean | largest | negative |"
    lines = [head, "|---|---|---:|---:|---:|---:|"]
    for material in dict.fromkeys(target.material for target in targets):
        some = [target for target in targets if target.material == material]
        samples = [int(target.metadata["samples"]) for target in some]
        noises = [100 * target.noise for target in some]
        lines.append(
            f"| {material} | {some[0].metadata['plugin']} | {min(samples)} to {max(samples)} | "
            f"{sum(noises) / len(noises):.2f} % | {max(noises):.2f} % | {100 * max(t.negative for t in some):.2g} % |"
        )
    above = [target for target in targets if target.noise > noise]
    if not above:
        return "\n".join([*lines, f"\nAll {len(targets)} targets have at most {100 * noise:g} % noise."])
    lines.append(f"\n{len(above)} of {len(targets)} targets have more than {100 * noise:g} %; raise --max-samples:")
    for target in above:
        spent = f"{100 * target.noise:.2f} % with all {target.metadata['samples']} samples allowed"
        lines.append(f"- {target.material} under {target.probe}: {spent}")
    return "\n".join(lines)


def sheet(path: Path, targets: Sequence[Target]) -> None:
    """A picture of all targets: a row for each material, a column with its own exposure for each probe."""
    probes = list(dict.fromkeys(target.probe for target in targets))
    mask = tb.SphereView(targets[0].size).mask
    scales = {name: common_exposure([target.image for target in targets if target.probe == name]) for name in probes}
    rows: dict[str, list[torch.Tensor]] = {}
    for target in sorted(targets, key=lambda target: probes.index(target.probe)):
        shown = on_white(target.photograph, mask, scales[target.probe])
        rows.setdefault(target.material.removesuffix("_rgb"), []).append(shown)
    write_sheet(path, rows, probes, tile=96)


def run(options: argparse.Namespace) -> int:
    quality = Quality(options.size, options.samples, options.noise, options.max_samples, options.seed, options.turned)
    materials = measured_materials(options.measured) if options.measured else []
    materials += analytic_materials() if options.analytic else []
    if not materials:
        raise ValueError("no materials; give --measured FOLDER, --analytic or both")
    if options.materials:
        known = {material.name: material for material in materials}
        unknown = [name for name in options.materials if name not in known]
        if unknown:
            raise ValueError(f"no material {unknown[0]!r} here; there are {', '.join(known)}")
        materials = [known[name] for name in options.materials]
    load_mitsuba()
    probes = open_probes(options.probes or default_probes())
    made = list(make_targets(options.output, materials, probes, quality))
    targets = [Target.open(path) for path, problem in made if problem is None]
    if targets:
        print(describe(targets, quality.noise))
        if options.sheet:
            sheet(options.sheet, targets)
    problems = [problem for _, problem in made if problem is not None]
    for problem in problems:
        fail("make_targets", problem)
    return BAD_INPUT if problems else 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--measured", type=Path, metavar="FOLDER", help="render the .bsdf files of this folder")
    parser.add_argument("--analytic", action="store_true", help=f"render {len(ANALYTIC)} analytic materials")
    parser.add_argument("--materials", nargs="+", metavar="NAME", help="only these of them")
    parser.add_argument("--probes", nargs="+", type=Path, metavar="FILE", help="default: 7 of ../shared/data/probes")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the targets")
    parser.add_argument("--size", type=int, default=64, help="pixels along a side")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="a pixel")
    parser.add_argument("--noise", type=float, default=NOISE, help="add samples above this relative noise")
    parser.add_argument("--max-samples", type=int, default=MAX_SAMPLES, help="a pixel, for the noisiest targets")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--turned", type=float, default=0, metavar="DEG", help="turn each target's probe by up to this")
    parser.add_argument("--sheet", type=Path, metavar="PNG", help="write a picture of all targets")
    return exit_status("make_targets", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
