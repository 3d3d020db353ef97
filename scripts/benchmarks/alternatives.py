#!/usr/bin/env python3
"""Claim: from one photograph the default comes closer to a measured material than what people use instead, and sooner.

    torchbrdf precompute
    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmarks/alternatives.py --targets targets

Every material, each without its family in the embedded library, is photographed with 1 % noise and recovered by

- naive least squares: all columns, no penalty;
- the method of the paper: four classes, lambda = 0.5;
- torchbrdf as it is by default;
- Mitsuba: inverse rendering of `principled`, its gradients, Adam from the middle of all ranges;
- torchbrdf's own fit of the same model to the photograph, bounded least squares from several starts.

Seconds are those of one photograph under a light that is new, from the probe and the photograph to a table or to
parameters; what is done once for a library (`precompute`, classes) and compiling Mitsuba's kernels (a fit that is not
counted) come before. error = |rendered - target| / |target| under each light that the photograph was not taken under.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from measured import experiment_of, measured_options, publish
from torchbrdf.analytic import CellTransport, model_of
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import Experiment, markdown_table, percent
from torchbrdf.mitsuba_backend import MitsubaScene, load_mitsuba

NOISE = 1
"""Per cent of each pixel."""

LINEAR: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {
    "naive least squares": ({"n_classes": 1}, {"penalty": 0.0}),
    "the paper, on our transport": ({}, {"penalty": "paper"}),
    "**torchbrdf**": ({}, {}),
}
"""What `MaterialClasses.fit` and `BRDFEstimator` are given."""

MITSUBA = "Mitsuba, inverse rendering of `principled`"
ANALYTIC = "torchbrdf, `principled` fitted to the photograph"

STEPS, RATE, SAMPLES = 300, 0.02, 32
"""Of Adam; a rate of 0.05 and 200 steps left more under venice, which is not reported."""

_COLOUR = "base_color"
_START = {"roughness": 0.5, "metallic": 0.2, "specular": 0.5, "spec_tint": 0.1, "clearcoat": 0.2, "sheen": 0.1}
_START |= {"sheen_tint": 0.1, "flatness": 0.1}
_BOUNDS = 0.001, 0.999


@dataclass(frozen=True)
class Recovered:
    """What a method made of one photograph: seconds, and a renderer of it under a probe of the experiment."""

    seconds: float
    under: Callable[[str], Tensor]


@dataclass(frozen=True)
class Error:
    """Of a recovered material under one new light, and how long its recovery took."""

    method: str
    material: str
    observed: str
    novel: str
    error: float
    seconds: float


def linear(
    fold: Experiment,
    classes: tb.MaterialClasses,
    settings: Mapping[str, Any],
    photograph: Tensor,
    observed: str,
    whole: tb.MaterialLibrary,
) -> Recovered:
    """Basis images, factors, weights and table."""
    dropped = sorted(set(whole.names) - set(fold.library.names))
    start = time.perf_counter()
    basis = tb.render_basis(whole, fold.probes[observed], fold.view, backend="harmonic").without(*dropped)
    result = tb.BRDFEstimator(basis, classes, library=fold.library, **settings)(photograph)
    result.brdf(fold.library)
    seconds = time.perf_counter() - start
    return Recovered(seconds, lambda name: fold.relit(result.weights[None], [name])[name][0])


def principled(colour: Sequence[float], parameters: Mapping[str, float]) -> dict[str, Any]:
    """The BSDF as a dictionary of Mitsuba's."""
    return {"type": "principled", _COLOUR: {"type": "rgb", "value": list(colour)}, **parameters}


def mitsuba(fold: Experiment, photograph: Tensor, observed: str, steps: int = STEPS) -> Recovered:
    """Gradient descent through Mitsuba's renderer on the relative squared error."""
    mi = load_mitsuba()
    import drjit

    start = time.perf_counter()
    scene = MitsubaScene(fold.view, fold.probes[observed], principled([0.5] * 3, _START)).scene
    parameters = mi.traverse(scene)
    names = {key: key.split(".")[2] for key in dict(parameters) if key.startswith("shape.bsdf.")}
    names = {key: name for key, name in names.items() if name == _COLOUR or name in _START}
    optimiser = mi.ad.Adam(lr=RATE)
    for key in names:
        optimiser[key] = parameters[key]
    parameters.update(optimiser)
    target = mi.TensorXf(photograph.permute(1, 2, 0).contiguous().numpy())
    mask = mi.TensorXf(fold.view.mask.permute(1, 2, 0).float().expand(-1, -1, 3).contiguous().numpy())
    scale = 1 / float(photograph.double().square().sum())
    for step in range(steps):
        image = mi.render(scene, parameters, spp=SAMPLES, seed=step)
        drjit.backward(scale * drjit.sum(drjit.square((image - target) * mask)))
        optimiser.step()
        for key in names:
            optimiser[key] = drjit.clip(optimiser[key], *_BOUNDS)
        parameters.update(optimiser)
    found = {name: [float(value) for value in torch.tensor(optimiser[key]).flatten()] for key, name in names.items()}
    seconds = time.perf_counter() - start
    bsdf = principled(found.pop(_COLOUR), {name: value for name, (value,) in found.items()})
    return Recovered(seconds, lambda name: MitsubaScene(fold.view, fold.probes[name], bsdf).render(1024))


def analytic(fold: Experiment, photograph: Tensor, observed: str, transports: Mapping[str, CellTransport]) -> Recovered:
    """`fit_analytic_to_image` from starts that know nothing."""
    start = time.perf_counter()
    fit = tb.fit_analytic_to_image(photograph, fold.probes[observed], fold.view, "principled")
    seconds = time.perf_counter() - start

    def under(name: str) -> Tensor:
        transport = transports[name]
        return fold.view.unpack(transport.render(model_of("principled").evaluate(fit.parameters, transport.geometry)).T)

    return Recovered(seconds, under)


def errors(experiment: Experiment, observed: Sequence[str]) -> Iterator[Error]:
    """Of every method, material, light of `observed` and other light."""
    transports = {name: CellTransport.build(probe, experiment.view) for name, probe in experiment.probes.items()}
    warm_up = experiment.observations(observed[0], [NOISE])[0, 0].float()
    mitsuba(experiment, warm_up, observed[0], steps=2)
    progress = tqdm(total=len(experiment.materials) * len(observed), desc="photographs")
    for fold in experiment.folds("family"):
        classes = {name: tb.MaterialClasses.fit(fold.library, **some) for name, (some, _) in LINEAR.items()}
        photographs = {name: fold.observations(name, [NOISE])[0].float() for name in observed}
        for (i, material), light in ((one, light) for one in enumerate(fold.materials) for light in observed):
            photograph = photographs[light][i]
            found = {
                name: linear(fold, classes[name], settings, photograph, light, experiment.library)
                for name, (_, settings) in LINEAR.items()
            }
            found[MITSUBA] = mitsuba(fold, photograph, light)
            found[ANALYTIC] = analytic(fold, photograph, light, transports)
            progress.update()
            for method, recovered in found.items():
                for novel in (name for name in fold.probes if name != light):
                    error = fold.error(recovered.under(novel), material, novel)
                    yield Error(method, material, light, novel, error, recovered.seconds)


def summary(found: Sequence[Error]) -> str:
    """A row a method: seconds, mean error, nine tenths, worst."""
    rows = []
    for method in dict.fromkeys(one.method for one in found):
        some = [one for one in found if one.method == method]
        values = sorted(one.error for one in some)
        seconds = statistics.median(one.seconds for one in some)
        tenth = statistics.quantiles(values, n=10, method="inclusive")[-1]
        rows.append([method, f"{seconds:.2g}", *map(percent, (statistics.mean(values), tenth, values[-1]))])
    return markdown_table(["from one photograph", "seconds", "error, %", "90 % below", "worst"], rows)


def run(options: argparse.Namespace) -> None:
    experiment = experiment_of(options)
    found = list(errors(experiment, options.observe))
    methods = {one.method for one in found}
    about = (
        f"{len(experiment.materials)} materials, {NOISE} % noise, photographs under {', '.join(options.observe)}, "
        f"shown under the {len(experiment.probes) - 1} other lights: {len(found) // len(methods)} errors a method. "
        f"torchbrdf {tb.__version__}, {torch.get_num_threads()} threads."
    )
    publish(options, found, summary(found), f"{about}\n\n")


def main() -> int:
    parser = Parser.of_script(__doc__)
    measured_options(parser)
    return exit_status("alternatives", run, parser.parse_args(), "interrupted")


if __name__ == "__main__":
    sys.exit(main())
