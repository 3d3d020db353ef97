"""The cases of scripts/benchmarks/silhouette.py: a pure function that runs in any process of a sweep."""

import time
from collections.abc import Mapping
from math import cos, degrees, pi, radians, sin, tan
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, normalize

import torchbrdf as tb
from alignment_cases import basis_under, classes_of
from torchbrdf.experiments import light_under, noisy_observations, open_library, without_relatives
from torchbrdf.images import read_image, relative_rms
from torchbrdf.light import rotation_angle, rotation_of
from torchbrdf.photograph import Circle, Observation, observe

SIZE = 64
ACROSS = 192
"""Pixels across the ball in a photograph."""

FINER = 4
"""Renderings are so much finer, and averaged to pixels that the silhouette cuts anywhere."""

_FRAME = 240
_CORNER = 97, 99
"""Fine pixels above and left of the ball."""

_RIM = 2
"""Fine pixels inside the silhouette that show what those across it would."""

_BEHIND = radians(8)
"""From the ball's middle to its silhouette, in directions of the surroundings behind it."""

TRUTH = Circle(_CORNER[1] / FINER + ACROSS / 2, _CORNER[0] / FINER + ACROSS / 2, ACROSS / 2)
_PIXEL = ACROSS / SIZE


def photograph(rendering: Tensor, probe: tb.LightProbe, noise: float, key: str) -> Tensor:
    """(3, 240, 240): a fine rendering (3, N, N) of a ball before the light around it, with noise in per cent."""
    n, extent = FINER * ACROSS, FINER * _FRAME
    y, x = torch.meshgrid(*((torch.arange(extent) + 0.5 - corner - n / 2) for corner in _CORNER), indexing="ij")
    step = tan(_BEHIND) / (n / 2)
    directions = normalize(torch.stack([step * x, -step * y, -torch.ones_like(x)], -1), dim=-1)
    fine = probe.radiance_at(directions).movedim(-1, 0)
    distance = torch.hypot(x, y).clamp_min(1e-3)
    covered = (n / 2 + 0.5 - distance).clamp(0, 1)
    inwards = (n / 2 - _RIM) / distance.clamp_min(n / 2 - _RIM)  # targets are black where the silhouette cuts a pixel
    row, column = ((n / 2 + inwards * place).floor().long() for place in (y, x))
    fine = torch.lerp(fine, rendering.clamp_min(0)[:, row, column], covered)
    clean = avg_pool2d(fine, FINER)
    return noisy_observations(clean, [noise], key)[0].float()


def silhouette_case(
    library: str,
    probes: Mapping[str, str],
    observed: str,
    material: str,
    off: tuple[float, float],
    turned: float,
    noise: float,
    seed: int,
    library_path: str,
    probe_paths: Mapping[str, str],
    renderings: str,
) -> dict[str, float]:
    """Align a photograph whose silhouette is guessed wrongly, and compare under all other probes.

    library, probes  fingerprints; those probes that are not observed are the new lights
    off              pixels of 64 by which the guess is moved, in a random direction, and grown
    turned           degrees by which the probe is turned about a random axis
    """
    known = without_relatives(open_library(library_path, library), material)
    lights = {name: light_under(known, probe_paths[name], probes[name], SIZE) for name in probes}
    view, classes = tb.SphereView(SIZE), classes_of(known)
    fine = {name: read_image(Path(renderings) / name / f"{material}.exr") for name in probes}
    generator = torch.Generator().manual_seed(seed)
    azimuth = 2 * pi * float(torch.rand(1, generator=generator))
    axis = normalize(torch.randn(3, generator=generator, dtype=torch.float64), dim=0)
    image = photograph(fine[observed], lights[observed].probe, noise, f"{seed} {material} {observed}")
    guess = Circle(
        TRUTH.x + _PIXEL * off[0] * cos(azimuth),
        TRUTH.y + _PIXEL * off[0] * sin(azimuth),
        TRUTH.radius + _PIXEL * off[1],
    )
    rotation = rotation_of(radians(turned) * axis)
    given = lights[observed] if not turned else None
    probe = lights[observed].probe if given else lights[observed].probe.rotated(rotation.T)

    def novel_error(seen: Observation, basis: tb.BasisImages) -> float:
        weights = tb.BRDFEstimator(basis, classes)(seen.image, seen.mask).weights
        errors = []
        for name in probes:
            if name != observed:
                shown = basis_under(lights[name]).render(weights).clamp_min(0)
                errors.append(relative_rms(shown, avg_pool2d(fine[name].clamp_min(0), FINER * 3), view.mask))
        return sum(errors) / len(errors)

    started, cpu = time.perf_counter(), time.process_time()
    found = tb.align(image, probe, view, known, silhouette=guess)
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    circle = found.silhouette
    assert isinstance(circle, Circle)
    assert found.observation is not None
    assert found.ball is not None
    before = basis_under(given) if given else tb.HarmonicBasis(known, probe, view).basis_at()
    return {
        "ideal": novel_error(observe(image, TRUTH, size=SIZE), basis_under(lights[observed])),
        "before": novel_error(observe(image, guess, size=SIZE), before),
        "after": novel_error(found.observation, found.basis),
        "x": (circle.x - TRUTH.x) / _PIXEL,
        "y": (circle.y - TRUTH.y) / _PIXEL,
        "radius": (circle.radius - TRUTH.radius) / _PIXEL,
        "std": max(found.ball.std) / _PIXEL,
        "moved": float(found.ball.moved),
        "left": degrees(rotation_angle(found.rotation @ rotation.T)),
        "evaluations": found.evaluations,
        "seconds": seconds,
        "cpu": cpu,
    }
