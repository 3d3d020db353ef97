"""The tasks of scripts/rotation_robustness.py: pure functions that run in any process of a sweep.

What is slow to open or to compute and the same for many tasks is remembered by each process.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import radians
from typing import Any

import torch
from torch import Tensor

import torchbrdf as tb
from paper.rotation.methods import METHODS, Capture, LeftOut, Lit, partition
from torchbrdf.brdf import columns_of
from torchbrdf.experiments import light_under, noisy_observations, open_library, without_relatives
from torchbrdf.light import rotation_of

AXES = "XYZ"


@dataclass(frozen=True)
class Turn:
    """A rotation of the light about +X, +Y or +Z, counterclockwise seen from the tip of the axis."""

    axis: str = "Y"
    degrees: float = 0

    def __str__(self) -> str:
        """Such as 5X, or 0."""
        return f"{self.degrees:g}{self.axis}" if self.degrees else "0"

    @property
    def rotation(self) -> Tensor | None:
        """(3, 3); None for no turn."""
        if not self.degrees:
            return None
        vector = torch.zeros(3, dtype=torch.float64)
        vector[AXES.index(self.axis)] = radians(self.degrees)
        return rotation_of(vector)


@lru_cache(maxsize=16)
def lit(light: tb.HarmonicBasis, turn: Turn) -> Lit:
    """The library under a turned probe."""
    return Lit.of(light.basis_at(turn.rotation))


@lru_cache(maxsize=1024)
def left_out(library: tb.MaterialLibrary, name: str, labels: str, n_dims: int) -> LeftOut:
    """A material and the classes, a digit a column, of the library without its family."""
    less = without_relatives(library, name)
    kept = columns_of([library.position(other) for other in less.names])
    classes = partition(less, torch.tensor([int(label) for label in labels]), n_dims)
    return LeftOut(name, library.position(name), less, kept, classes)


def fit_classes(
    library: str, n_classes: int, n_dims: int, materials: Sequence[str | None], library_path: str
) -> list[str]:
    """The class of every column of the library less the family of each of some materials, or less none for None."""
    whole = open_library(library_path, library)
    found = []
    for name in materials:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # fewer classes than asked for: the report counts them
            classes = tb.MaterialClasses.fit(without_relatives(whole, name) if name else whole, n_classes, n_dims)
        found.append("".join(map(str, classes.labels.tolist())))
    return found


def reconstruct(
    library: str,
    probes: Mapping[str, str],
    observed: str,
    photographed: Sequence[Any],
    believed: Sequence[Any],
    method: str,
    materials: Mapping[str, str],
    n_dims: int,
    noise: Sequence[float],
    size: int,
    seed: int,
    library_path: str,
    probe_paths: Mapping[str, str],
) -> dict[str, list[Any]]:
    """Photograph materials under one light, reconstruct them under another, and compare under the probes as they are.

    library, probes    fingerprints; those probes that are not observed are the new lights, not turned
    photographed, believed  axis and degrees of the turn of the observed probe
    materials          to photograph: name -> classes of the others, see `left_out`
    returns            columns of the results, a row for each material and noise level. error and energy are |Y w - y|^2
                       under the believed light and |y|^2 of the photograph; own_light_error and novel_error are
                       |rendered - truth| / |truth| under the observed probe and the others, none of them turned
    """
    whole = open_library(library_path, library)
    lights = {name: light_under(whole, probe_paths[name], probes[name], size) for name in probes}
    light, turn = lights[observed], Turn(*believed)
    truth, belief = lit(light, Turn(*photographed)), lit(light, turn)
    without = [left_out(whole, name, labels, n_dims) for name, labels in materials.items()]
    positions = [one.position for one in without]
    clean = [truth.basis.pack(truth.basis.image(name)).double() for name in materials]
    keys = [f"{seed} {name} {observed}" for name in materials]
    photographs = torch.stack([noisy_observations(y, noise, key) for y, key in zip(clean, keys, strict=True)])
    found = METHODS[method].reconstruct(Capture(light, turn.rotation, belief, photographs, without))
    new = [lit(other, Turn()).errors(found.weights, positions) for name, other in lights.items() if name != observed]
    numbers = {
        "class": found.class_index,
        "error": found.error,
        "energy": photographs.square().sum((-2, -1)),
        "own_light_error": lit(light, Turn()).errors(found.weights, positions),
        "novel_error": torch.stack(new).mean(0),
    }
    return {
        "material": [name for name in materials for _ in noise],
        "noise_percent": [level for _ in materials for level in noise],
        **{key: values.flatten().tolist() for key, values in numbers.items()},
    }
