#!/usr/bin/env python3
"""Claim: a small network before `BRDFEstimator`, trained end to end, recovers spoilt photographs that no other does.

    python scripts/train_denoiser.py --seeds 0 1 2

A ball of a random combination of basis BRDFs is photographed with objects in front that no mask tells, bands of flicker
and correlated noise. The network says how far to believe each pixel and corrects exposure; the estimator fills the
gaps with what it recovers from the rest. The loss is the error under other light. Figures are for materials that
neither the library of the estimator nor the training has seen, under light that was not trained under:
|rendered - truth| / |truth|, in per cent. Each seed has its own held-out materials, network and defects.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from kornia.augmentation import AugmentationSequential
from torch import Tensor, nn
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import Restorer, relative
from torchbrdf.files import writing
from torchbrdf.learning import RandomFlicker, RandomOccluders, RandomSensorNoise, ReflectanceMaps, random_rotations

REPEATS = 3
"""Photographs of each held-out material."""


def defects(known: bool = False) -> AugmentationSequential:
    """What spoils the photographs, in training and in the test; known: whether masks tell the objects."""
    return AugmentationSequential(
        RandomOccluders((1, 3), (0.15, 0.5), p=1.0, known=known),
        RandomFlicker((0.05, 0.2), p=1.0),
        RandomSensorNoise((0.05, 0.15), (0.01, 0.03), blur=0.7),
        data_keys=["input", "mask"],
    )


def lamps(height: int = 64, count: int = 12) -> tb.LightProbe:
    """Small coloured lamps in a dim room: light unlike the default probe's."""
    generator = torch.Generator().manual_seed(0)
    radiance = torch.full((3, height, 2 * height), 0.05)
    rows = torch.randint(height // 8, 7 * height // 8, (count,), generator=generator)
    columns = torch.randint(2 * height, (count,), generator=generator)
    radiance[:, rows, columns] = 60 * torch.rand(3, count, generator=generator)
    return tb.LightProbe(radiance, name="lamps")


@dataclass(frozen=True, eq=False)
class Lights:
    """Basis images of a library: under the light of the photographs, those trained under, and that of the test."""

    library: tb.MaterialLibrary
    photograph: tb.BasisImages
    training: tuple[tb.BasisImages, ...]
    test: tb.BasisImages
    view: tb.View


def render_lights(options: argparse.Namespace) -> Lights:
    library = tb.MaterialLibrary.from_files(options.library or "default")
    view = tb.SphereView(options.size)
    probe = tb.LightProbe.default() if options.probe is None else tb.LightProbe.open(options.probe, rows="poles")
    novel = lamps() if options.novel is None else tb.LightProbe.open(options.novel, rows="poles")
    torch.manual_seed(0)
    turned = [probe.rotated(rotation) for rotation in random_rotations(options.training_lights)]
    found = [tb.render_basis(library, one, view) for one in tqdm([probe, novel, *turned], desc="lights")]
    return Lights(library, found[0], tuple(found[2:]), found[1], view)


def train(
    restorer: Restorer, maps: ReflectanceMaps, lights: Sequence[tb.BasisImages], options: argparse.Namespace
) -> None:
    """Minimise the error under other light, and that of the restored photograph."""
    optimiser = torch.optim.AdamW(restorer.parameters(), lr=options.rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, options.rate, total_steps=options.steps)
    progress = tqdm(range(options.steps), desc=f"seed {maps.seed}")
    for step in progress:
        batch = maps[list(range(step * options.batch, (step + 1) * options.batch))]
        light = lights[step % len(lights)]
        restored = restorer(batch["image"])
        weights = restorer.estimate(restored).weights
        novel = relative(light.render(weights), light.render(batch["weights"])).mean()
        loss = novel + relative(restored, batch["clean"]).mean()
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(restorer.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        progress.set_postfix(novel=f"{float(novel.detach()):.3f}")


def run_seed(seed: int, lights: Lights, options: argparse.Namespace) -> tuple[dict[str, Tensor], Restorer]:
    """Errors of all held-out photographs, by method."""
    torch.manual_seed(seed)
    names = lights.photograph.names
    held_out = [names[i] for i in torch.randperm(len(names))[: options.held_out]]
    basis, test = lights.photograph.without(*held_out), lights.test.without(*held_out)
    classes = tb.MaterialClasses.fit(lights.library.without(*held_out))
    plain, robust = tb.BRDFEstimator(basis, classes), tb.BRDFEstimator(basis, classes, robust=True)
    restorer = Restorer(plain, lights.view, options.width, options.rounds)
    maps = ReflectanceMaps(basis, defects(), length=options.steps * options.batch, seed=seed)
    train(restorer, maps, [one.without(*held_out) for one in lights.training], options)

    clean = torch.stack([lights.photograph.image(name) for name in held_out]).repeat(REPEATS, 1, 1, 1)
    wanted = torch.stack([lights.test.image(name) for name in held_out]).repeat(REPEATS, 1, 1, 1)
    photographs, free = defects(known=True)(clean, lights.view.mask.expand(len(clean), -1, -1, -1))
    methods: dict[str, Callable[[], tb.Reconstruction]] = {
        "trained": lambda: plain(restorer(photographs)),
        "plain": lambda: plain(photographs),
        "robust=True": lambda: robust(photographs),
        "told the objects' masks": lambda: plain(photographs, free),
        "without defects": lambda: plain(clean),
    }
    with torch.no_grad():
        return {name: relative(test.render(method().weights), wanted) for name, method in methods.items()}, restorer


def table(found: Mapping[int, Mapping[str, Tensor]]) -> str:
    """A row for each method: mean for each seed, then mean, median and 90 % of all."""
    methods = list(next(iter(found.values())))
    lines = [f"| mean error, % | {' | '.join(f'seed {seed}' for seed in found)} | all | median | 90 % |"]
    lines.append("|---|" + "---:|" * (len(found) + 3))
    for method in methods:
        every = torch.cat([errors[method] for errors in found.values()])
        cells = [errors[method].mean() for errors in found.values()]
        cells += [every.mean(), every.median(), every.quantile(0.9)]
        lines.append(f"| {method} | {' | '.join(f'{100 * float(cell):.1f}' for cell in cells)} |")
    return "\n".join(lines)


def run(options: argparse.Namespace) -> None:
    start = time.perf_counter()
    lights = render_lights(options)
    found = {}
    for seed in options.seeds:
        found[seed], restorer = run_seed(seed, lights, options)
        better = statistics.mean((found[seed]["trained"] < found[seed]["plain"]).float().tolist())
        print(f"seed {seed}: better than plain in {100 * better:.0f} % of {len(found[seed]['plain'])} photographs")
        if options.save is not None:
            with writing(options.save) as temporary:
                torch.save(restorer.state_dict(), temporary)
    print(f"\n{table(found)}\n\n{time.perf_counter() - start:.0f} s")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="one training each")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--size", type=int, default=24, help="pixels along a side, a multiple of 4")
    parser.add_argument("--width", type=int, default=8, help="channels at full resolution")
    parser.add_argument("--rounds", type=int, default=3, help="how often gaps are filled anew")
    parser.add_argument("--rate", type=float, default=4e-3, help="largest learning rate")
    parser.add_argument("--held-out", type=int, default=20, metavar="N", help="materials of the test")
    parser.add_argument("--training-lights", type=int, default=4, metavar="N", help="the probe turned at random")
    parser.add_argument("--library", type=Path, help="folder of MERL *.binary tables; default: the embedded library")
    parser.add_argument("--probe", type=Path, help="light of the photographs; default: the default probe")
    parser.add_argument("--novel", type=Path, help="light of the test; default: small coloured lamps")
    parser.add_argument("--save", type=Path, metavar="PT", help="write the last network's state_dict")
    return exit_status("train_denoiser", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
