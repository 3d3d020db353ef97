"""Targets: renderings of known materials by another renderer, on which accuracy is measured, and sheets of pictures.

A target is an .exr whose metadata say what it shows and how noisy it is; scripts/make_targets.py writes them as
FOLDER/PROBE/MATERIAL.exr, scripts/benchmarks/accuracy.py reads them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from torchbrdf.images import read_image, read_metadata

FORMAT = "torchbrdf target 1"

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


