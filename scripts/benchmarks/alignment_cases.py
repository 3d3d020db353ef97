"""The cases of scripts/benchmarks/alignment.py: a pure function that runs in any process of a sweep."""

import json
import time
from collections.abc import Mapping
from functools import lru_cache
from math import degrees
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.experiments import Target, light_under, noisy_observations, open_library, without_relatives
from torchbrdf.images import relative_rms
from torchbrdf.light import rotation_angle, rotation_vector


@lru_cache(maxsize=16)
def classes_of(library: tb.MaterialLibrary) -> tb.MaterialClasses:
    """The material classes."""
    return tb.MaterialClasses.fit(library)


@lru_cache(maxsize=16)
def basis_under(light: tb.HarmonicBasis) -> tb.BasisImages:
    """The library under a probe as it is."""
    return light.basis_at()


def photograph(path: Path, noise: float, seed: int) -> tuple[Tensor, Tensor]:
    """A target as a camera records it, with noise of so many per cent; and the rotation (3, 3) of its probe."""
    target = Target.open(path)
    clean = target.photograph
    key = f"{seed} {target.material} {target.probe} {'rotation' in target.metadata}"
    noisy = noisy_observations(clean, [noise], key)[0].float()
    rotation = json.loads(target.metadata["rotation"]) if "rotation" in target.metadata else torch.eye(3).tolist()
    return noisy, torch.tensor(rotation, dtype=torch.float64)


def align_case(
    library: str,
    probes: Mapping[str, str],
    observed: str,
    material: str,
    noise: float,
    size: int,
    seed: int,
    library_path: str,
    probe_paths: Mapping[str, str],
    turned: str,
    unturned: str,
) -> dict[str, float]:
    """Align one photograph whose probe was turned, and one whose probe was right; compare under all other probes.

    library, probes   fingerprints; those probes that are not observed are the new lights
    turned, unturned  folders of targets
    """
    known = without_relatives(open_library(library_path, library), material)
    lights = {name: light_under(known, probe_paths[name], probes[name], size) for name in probes}
    light, classes = lights[observed], classes_of(known)
    novel = {name: Target.open(Path(unturned) / name / f"{material}.exr") for name in probes if name != observed}

    def novel_error(image: Tensor, basis: tb.BasisImages) -> float:
        weights = tb.BRDFEstimator(basis, classes)(image).weights
        errors = []
        for name, target in novel.items():
            shown = basis_under(lights[name]).render(weights).clamp_min(0)
            errors.append(relative_rms(shown, target.photograph, light.view.mask))
        return sum(errors) / len(errors)

    image, rotation = photograph(Path(turned) / observed / f"{material}.exr", noise, seed)
    started = time.perf_counter()
    found = tb.align(image, light.probe, light.view, known)
    seconds = time.perf_counter() - started
    left = rotation_vector(found.rotation @ rotation.T)
    right, _ = photograph(Path(unturned) / observed / f"{material}.exr", noise, seed)
    kept = tb.align(right, light.probe, light.view, known)
    return {
        "turned": degrees(rotation_angle(rotation)),
        "left": degrees(float(left.norm())),
        "uncertainty": found.uncertainty,
        "deviations": float((left @ torch.linalg.inv(found.covariance) @ left).sqrt()),
        "log_odds": found.log_odds,
        "evaluations": found.evaluations,
        "seconds": seconds,
        "error_true": novel_error(image, light.basis_at(rotation)),
        "error_given": novel_error(image, basis_under(light)),
        "error_aligned": novel_error(image, found.basis),
        "right_turned": kept.angle,
        "right_log_odds": kept.log_odds,
        "right_error": novel_error(right, basis_under(light)),
        "right_error_aligned": novel_error(right, kept.basis),
    }
