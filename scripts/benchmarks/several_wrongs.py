#!/usr/bin/env python3
"""Claim: where several things are wrong with a capture at once, no setting of ours does worse than the paper's method.

    torchbrdf precompute
    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmarks/several_wrongs.py --targets targets

Measured materials, each without its family in the embedded library, are photographed with one of the combinations
below and recovered with the probe as it is given. error = |rendered - target| / |target| under each light that the
photograph was not taken under, means over materials and lights in per cent.
"""

import argparse
import statistics
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from capture_sensitivity import clipped
from measured import experiment_of, measured_options, publish
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import Experiment, markdown_table, noisy_observations, percent, tilt

SMALL = 24
STAND = 0.3
"""Radiance of the stand, in means of the photograph."""


def noisy(image: Tensor, level: float, key: str) -> Tensor:
    """Each pixel and channel with noise of so many per cent of itself."""
    return noisy_observations(image, [level], key)[0].float()


def with_stand(image: Tensor, view: tb.View) -> Tensor:
    """A grey stand before the lower end of the ball, which no mask names."""
    height, width = view.size
    below = torch.arange(height)[:, None] > 0.9 * height
    stand = below & (torch.arange(width) - width / 2).abs().lt(0.08 * width) & view.mask[0]
    return torch.where(stand, STAND * image[:, view.mask[0]].mean(), image)


def smaller(image: Tensor, view: tb.View, size: int) -> Tensor:
    """The same ball on fewer pixels: means over what each sees of it."""
    edges = torch.linspace(0, image.shape[-1], size + 1)
    pixels = torch.arange(image.shape[-1])
    overlap = (torch.minimum(edges[1:, None], pixels + 1) - torch.maximum(edges[:-1, None], pixels)).clamp_min(0)
    seen, covered = (overlap @ layer @ overlap.T for layer in (image, view.mask.float()))
    return torch.where(covered > 0, seen / covered.clamp_min(1e-6), 0)


@dataclass(frozen=True)
class Wrong:
    """A probe turned by `degrees` about the axis of `tilt`, a ball of `size` pixels, and what spoils its photograph."""

    spoil: Callable[[Tensor, tb.View, str], Tensor]
    degrees: float = 0.0
    size: int | None = None


WRONGS = {
    "nothing but 1 % noise": Wrong(lambda image, view, key: noisy(image, 1, key)),
    "probe 1 degree off, brightest 2 % clipped, 1 % noise": Wrong(
        lambda image, view, key: clipped(masked=False)(noisy(image, 1, key), view.mask)[0], degrees=1
    ),
    "2 % noise, 10 % too bright, a stand in view": Wrong(
        lambda image, view, key: with_stand(noisy(1.1 * image, 2, key), view)
    ),
    "ball of 24 pixels, 2 % noise, probe 1 degree off": Wrong(
        lambda image, view, key: noisy(image, 2, key), degrees=1, size=SMALL
    ),
}

PAPER = "the paper"
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    "robust": {"robust": True},
    "w >= 0": {"constraint": "nonnegative"},
    PAPER: {"penalty": "paper"},
}
"""Arguments of BRDFEstimator, with the probe as it is given."""

ALIGNED: Mapping[str, Mapping[str, Any]] = {"aligned": {}, "aligned, robust": {"robust": True}}


@dataclass(frozen=True)
class Error:
    """Of a recovered material under one new light."""

    wrong: str
    setting: str
    material: str
    observed: str
    novel: str
    error: float


def errors(experiment: Experiment, observed: Sequence[str]) -> Iterator[Error]:
    """Of every combination, setting, material, light of `observed` and other light."""
    progress = tqdm(total=len(WRONGS) * len(observed) * len(experiment.materials), desc="photographs")
    for fold in experiment.folds("family"):
        classes = tb.MaterialClasses.fit(fold.library)
        for name, wrong in WRONGS.items():
            view = fold.view if wrong.size is None else tb.SphereView(wrong.size)
            for light in observed:
                probe = fold.probes[light]
                given = probe.rotated(tilt(wrong.degrees)) if wrong.degrees else probe
                basis = tb.render_basis(fold.library, given, view, backend="harmonic")
                images = []
                for material in fold.materials:
                    image = fold.targets[light][material].photograph
                    image = image if wrong.size is None else smaller(image, fold.view, wrong.size)
                    images.append(wrong.spoil(image, view, f"{material} {light}"))
                found = {
                    setting: tb.BRDFEstimator(basis, classes, library=fold.library, **some)(torch.stack(images)).weights
                    for setting, some in SETTINGS.items()
                }
                bases = [tb.align(image, given, view, fold.library).basis for image in images]
                for setting, some in ALIGNED.items():
                    estimates = (
                        tb.BRDFEstimator(one, classes, library=fold.library, **some)(image).weights
                        for one, image in zip(bases, images, strict=True)
                    )
                    found[setting] = torch.stack(list(estimates))
                progress.update(len(images))
                others = [other for other in fold.probes if other != light]
                for setting, weights in found.items():
                    rendered = fold.relit(weights, others)
                    for i, material in enumerate(fold.materials):
                        for novel in others:
                            error = fold.error(rendered[novel][i], material, novel)
                            yield Error(name, setting, material, light, novel, error)


def summary(found: Sequence[Error]) -> str:
    """Means, a row a combination, a column a setting; a star where it is above the paper's."""
    settings = [*dict.fromkeys(one.setting for one in found if one.setting != PAPER), PAPER]
    rows = []
    for wrong in dict.fromkeys(one.wrong for one in found):
        means = {
            setting: statistics.mean(one.error for one in found if (one.wrong, one.setting) == (wrong, setting))
            for setting in settings
        }
        stars = {setting: "*" if mean > means[PAPER] else "" for setting, mean in means.items()}
        rows.append([wrong, *(percent(mean) + stars[setting] for setting, mean in means.items())])
    return markdown_table(["what is wrong", *settings], rows)


def run(options: argparse.Namespace) -> None:
    found = list(errors(experiment_of(options), options.observe))
    publish(options, found, summary(found))


def main() -> int:
    parser = Parser.of_script(__doc__)
    measured_options(parser)
    return exit_status("several_wrongs", run, parser.parse_args(), "interrupted")


if __name__ == "__main__":
    sys.exit(main())
