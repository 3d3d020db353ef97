"""Targets: renderings of known materials by another renderer, on which accuracy is measured, and sheets of pictures.

A target is an .exr whose metadata say what it shows and how noisy it is; scripts/make_targets.py writes them as
FOLDER/PROBE/MATERIAL.exr, scripts/benchmark_accuracy.py reads them.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.files import writing
from torchbrdf.images import read_image, read_metadata, tone_map

FORMAT = "torchbrdf target 1"

PROBES = ("apartment.exr", "venice.exr", "forest.exr", "dawn.exr", "uffizi.hdr", "grace.hdr", "ennis.hdr")
"""Those of ../shared/data/probes that differ: uffizi_angularmap* are Uffizi again, bad_nan_inf is broken."""

SHARED = Path(__file__).resolve().parent.parent.parent / "shared" / "data"


def sweep_options(parser: argparse.ArgumentParser) -> None:
    """Where a sweep computes."""
    parser.add_argument("--processes", type=int, default=2, help="on this machine; default: 2")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="compute on the workers of a Dask scheduler")


def default_probes() -> list[Path]:
    """The files of PROBES."""
    return [SHARED / "probes" / name for name in PROBES]


def open_probes(paths: Sequence[Path]) -> dict[str, tb.LightProbe]:
    """Probes by the names of their files, each read once. Raises ValueError where two share a name."""
    probes: dict[str, tb.LightProbe] = {}
    for path in paths:
        if path.stem in probes:
            raise ValueError(f"{path}: another probe is called {path.stem}, too; rename one of the files")
        probes[path.stem] = tb.LightProbe.open(path)
    return probes


@dataclass(frozen=True)
class SweepInputs:
    """What the tasks of a sweep over targets read: the library and the probes under which targets were made.

    library   opened; probes: name -> fingerprint
    places    where they lie, for `Task.places`
    """

    library: tb.MaterialLibrary
    probes: Mapping[str, str]
    places: Mapping[str, Any]

    @classmethod
    def open(cls, library: Path | None, folder: Path, names: set[str]) -> "SweepInputs":
        """The embedded library for None, and probes by name in a folder. Raises ValueError where one is missing."""
        paths = {path.stem: path for path in sorted(folder.glob("*")) if path.stem in names}
        missing = names - set(paths)
        if missing:
            raise ValueError(f"{folder}: no probe {', '.join(sorted(missing))} here, under which targets were made")
        opened = tb.MaterialLibrary.from_merl(library) if library else tb.MaterialLibrary.default()
        places = {
            "library_path": str(library.resolve()) if library else "default",
            "probe_paths": {name: str(path.resolve()) for name, path in paths.items()},
        }
        probes = {name: probe.fingerprint for name, probe in open_probes(list(paths.values())).items()}
        return cls(opened, probes, places)


@dataclass(frozen=True, eq=False)
class Target:
    """A sphere of a material under a probe, orthographic.

    image     (3, N, N)  radiance as rendered, 0 outside the sphere; colours outside the gamut of RGB are negative
    noise     relative RMS of the image's Monte Carlo error
    metadata  of the file
    """

    material: str
    probe: str
    probe_fingerprint: str
    image: Tensor
    noise: float
    metadata: Mapping[str, str]

    @classmethod
    def open(cls, path: Path) -> "Target":
        """Read a file. Raises ValueError where it is no target."""
        metadata = read_metadata(path)
        if metadata.get("format") != FORMAT:
            raise ValueError(f"{path}: not a target ({FORMAT!r}); make targets with scripts/make_targets.py")
        return cls(
            material=metadata["material"],
            probe=metadata["probe"],
            probe_fingerprint=metadata["probe_fingerprint"],
            image=read_image(path),
            noise=float(metadata["noise"]),
            metadata=metadata,
        )

    @property
    def size(self) -> int:
        """N."""
        return self.image.shape[-1]

    @property
    def photograph(self) -> Tensor:
        """(3, N, N): what a camera would record: no channel is below zero."""
        return self.image.clamp_min(0)

    @property
    def negative(self) -> float:
        """|negative part| / |image|."""
        return negative_share(self.image)


def negative_share(image: Tensor) -> float:
    """|negative part| / |image|."""
    return float(image.clamp_max(0).norm() / image.norm())


def read_targets(folder: Path) -> list[Target]:
    """The targets of a folder, by probe and material.

    Raises FileNotFoundError where there are none, ValueError where one is something else or sizes differ.
    """
    targets = [Target.open(path) for path in sorted(folder.glob("*/*.exr")) if not path.name.startswith(".")]
    if not targets:
        raise FileNotFoundError(f"{folder}: no PROBE/MATERIAL.exr here; make targets with scripts/make_targets.py")
    sizes = sorted({target.size for target in targets})
    if len(sizes) > 1:
        raise ValueError(f"{folder}: targets must have one size, got {sizes}; make each size in a folder of its own")
    return targets


def exposure(images: Sequence[Tensor]) -> float:
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
