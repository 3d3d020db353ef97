"""The cases of scripts/benchmarks/precondition.py: one photograph, inverse rendering from several starts.

Pure functions that run in any process of a sweep; what is slow to open is remembered by each process.
"""

import hashlib
import time
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.analytic import AnalyticFit, CellTransport, Method, fit_analytic, fit_analytic_to_image, model_of
from torchbrdf.analytic.variables import FitVariables
from torchbrdf.experiments import Target, noisy_observations, open_library, swept_probe, without_relatives
from torchbrdf.images import relative_rms

TRUTH_SAMPLES, TRUTH_SEED = 4096, 1
"""Photographs of planted materials are rendered with other samples than fits."""


@lru_cache
def transport(path: str, fingerprint: str, size: int, truth: bool = False) -> CellTransport:
    """Of a probe on a sphere; truth: for photographs of planted materials."""
    probe = open_probe(path, fingerprint)
    view = tb.SphereView(size)
    return CellTransport.build(probe, view, TRUTH_SAMPLES, TRUTH_SEED) if truth else CellTransport.build(probe, view)


open_probe = lru_cache(swept_probe)


@lru_cache(maxsize=16)
def basis_images(library: tb.MaterialLibrary, path: str, fingerprint: str, size: int) -> tb.BasisImages:
    return tb.render_basis(library, open_probe(path, fingerprint), tb.SphereView(size))


@lru_cache(maxsize=16)
def estimator(library: tb.MaterialLibrary, path: str, fingerprint: str, size: int) -> tb.BRDFEstimator:
    return tb.BRDFEstimator(basis_images(library, path, fingerprint, size), tb.MaterialClasses.fit(library))


def random_parameters(model: str, seed: int, count: int) -> list[dict[str, Tensor]]:
    """Drawn evenly between the bounds, logarithms where the model has them."""
    variables = FitVariables(model_of(model))
    lower, upper = map(torch.from_numpy, variables.bounds)
    generator = torch.Generator().manual_seed(seed)
    draws = torch.rand(count, len(variables), dtype=torch.float64, generator=generator)
    return [variables.parameters(lower + (upper - lower) * draw) for draw in draws]


def picture(transport: CellTransport, f_r: Tensor) -> Tensor:
    """(3, H, W)."""
    return transport.view.unpack(transport.render(f_r).T)


def precondition(
    library: str,
    probes: Mapping[str, str],
    observed: str,
    material: str,
    model: str,
    planted: int | None,
    methods: Sequence[Method],
    random_starts: int,
    noise: float,
    size: int,
    seed: int,
    library_path: str,
    probe_paths: Mapping[str, str],
    targets: str,
) -> dict[str, Any]:
    """Fit a model to one photograph from the usual start, from random ones, and from our reconstruction's fit.

    planted  the material is the model itself, with this draw of parameters; None: a measured target
    returns  reconstruction_error and fit_error under light that was not observed, of our reconstruction and of the
             model fitted to it; seconds_before of both together; runs, one for each method and start: its loss, the
             history of losses as lists of evaluations, seconds and losses, and novel_error
    """
    known = without_relatives(open_library(library_path, library), material)
    chosen = model_of(model)
    lights = {name: transport(probe_paths[name], probes[name], size) for name in probes}
    if planted is None:
        truth = {name: Target.open(Path(targets) / name / f"{material}.exr").photograph for name in probes}
    else:
        parameters = random_parameters(model, planted, 1)[0]
        sources = {name: transport(probe_paths[name], probes[name], size, truth=True) for name in probes}
        truth = {name: picture(one, chosen.evaluate(parameters, one.geometry)) for name, one in sources.items()}
    view = lights[observed].view
    clean = view.pack(truth[observed]).double()
    key = f"{seed} {material} {observed}"
    photograph = view.unpack(noisy_observations(clean, [noise], key)[0]).float()

    def novel_error(pictures: Mapping[str, Tensor]) -> float:
        errors = [relative_rms(image, truth[name], view.mask) for name, image in pictures.items()]
        return sum(errors) / len(errors)

    def error_of(fit: AnalyticFit) -> float:
        new = {name: one for name, one in lights.items() if name != observed}
        f_r = {name: chosen.evaluate(fit.parameters, one.geometry) for name, one in new.items()}
        return novel_error({name: picture(one, f_r[name]) for name, one in new.items()})

    estimate = estimator(known, probe_paths[observed], probes[observed], size)
    began = time.perf_counter()
    result = estimate(photograph)
    fit = fit_analytic(result, model, library=known)
    seconds_before = time.perf_counter() - began
    reconstructed = {}
    for name in [name for name in probes if name != observed]:
        basis = basis_images(known, probe_paths[name], probes[name], size)
        reconstructed[name] = basis.render(result.weights)
    starts = {"default": chosen.defaults, "reconstruction": fit.parameters}
    draws = random_parameters(model, int.from_bytes(hashlib.sha256(key.encode()).digest()[:4]), random_starts)
    starts |= {f"random {i}": one for i, one in enumerate(draws)}
    runs = []
    for method in methods:
        for name, start in starts.items():
            end = fit_analytic_to_image(
                photograph,
                open_probe(probe_paths[observed], probes[observed]),
                view,
                model,
                start=start,
                method=method,
                transport=lights[observed],
            )
            columns = zip(*((one.evaluations, one.seconds, one.loss) for one in end.history), strict=True)
            runs.append(
                {
                    "method": method,
                    "start": name,
                    "loss": end.error**2,
                    "converged": end.converged,
                    "history": [list(column) for column in columns],
                    "novel_error": error_of(end),
                }
            )
    return {
        "reconstruction_error": novel_error(reconstructed),
        "fit_error": error_of(fit),
        "seconds_before": seconds_before,
        "runs": runs,
    }
