"""The facts about estimates: reconstructions, what photographs leave open, alignment, analytic fits."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

import torchbrdf as tb
from versions.python import OTHER, PHOTOGRAPHED, directions, numbers, scene, turn
from versions.record import Record

MODELS = (
    "lambert", "ggx", "metallic-roughness", "ggx-dielectric", "rough-conductor", "rough-plastic", "cook-torrance",
    "cook-torrance-dielectric", "ward", "ward-duer", "ward-bounded", "ashikhmin-shirley",
    "ashikhmin-shirley-dielectric", "ashikhmin-shirley-coupled", "low-microfacet", "principled", "oren-nayar",
)  # fmt: skip
METRICS = ("l2", "log", "cube-root", "image")
CONSTRAINTS = ("nonnegative", "convex", "energy")


def estimates(record: Record) -> None:
    """Reconstructions with every penalty and constraint, of one photograph, of batches and of several photographs."""
    library, basis, groups, photograph = scene().library, scene().basis, scene().classes, scene().photograph
    record.add("estimates: input/photograph", photograph)
    record.add("estimates: input/basis", basis.packed)
    options: dict[str, dict[str, Any]] = {
        "auto": {}, "paper": {"penalty": "paper"}, "0.05": {"penalty": 0.05}, "0": {"penalty": 0.0},
        "lstsq": {"penalty": 0.05, "solver": "lstsq"},
    }  # fmt: skip
    for constraint in CONSTRAINTS:
        given = {"constraint": constraint, "library": library}
        options |= {constraint: given, f"{constraint}, 0.05": given | {"penalty": 0.05}}
    for name, chosen in options.items():
        estimate = tb.BRDFEstimator(basis, groups, **chosen)
        record.add(f"estimates: {name}", {**_reconstruction(estimate(photograph)), "repr": repr(estimate)})
    record.add("estimates: state_dict", tb.BRDFEstimator(basis, groups).state_dict())
    spoiled = photograph.clone()
    spoiled[:, 8, 9:11], spoiled[:, 15, 12] = 0, 20 * photograph.max()
    mask = scene().view.mask & (numbers(2, *basis.size) < 0.8)
    half = mask & (torch.arange(basis.size[1]) < 13)
    batch = torch.stack([photograph, photograph.flip(-1), 0.3 * photograph + 0.1 * spoiled.sqrt()])
    for penalty in ("auto", 0.05):
        estimate = tb.BRDFEstimator(basis, groups, penalty)
        robust = tb.BRDFEstimator(basis, groups, penalty, robust=True)
        results = estimate(batch, torch.stack([mask, half, mask]))
        record.add(f"estimates: batches, masks, robust, {penalty}", {
            "robust": _reconstruction(robust(spoiled)), "masked": _reconstruction(estimate(photograph, mask)),
            "batch": _reconstruction(estimate(batch)), "batch, masked": _reconstruction(results),
            "one of it": _reconstruction(results[1]), "double": _reconstruction(estimate(photograph.double())),
            "gradient": _gradient(estimate, photograph),
        })  # fmt: skip

    turned = scene().probe.rotated(turn(90))
    bases = [basis, tb.render_basis(library, turned, scene().view, "sampled", samples=512)]
    second = tb.render(scene().whole.table(PHOTOGRAPHED), turned, scene().view, samples=1024, seed=2)
    several = tb.BRDFEstimator(bases, groups)([photograph, second], [mask, None])
    record.add("estimates: two photographs", _reconstruction(several))


def _reconstruction(result: tb.Reconstruction) -> dict[str, Any]:
    """Everything in it but the posteriors, which `what is open` shows."""
    found = {field.name: getattr(result, field.name) for field in fields(result) if field.name != "posteriors"}
    return found | {"relative error": result.relative_error}


def _gradient(estimate: tb.BRDFEstimator, photograph: Tensor) -> Tensor | None:
    image = photograph.clone().requires_grad_()
    result = estimate(image)
    (result.weights.square().sum() + result.image.square().sum()).backward()
    return image.grad


def open_questions(record: Record) -> None:
    """Tables of a reconstruction, their standard deviations, and what the light can tell."""
    library, groups = scene().library, scene().classes
    estimate = tb.BRDFEstimator(scene().basis, groups)
    result = estimate(scene().photograph)
    table, candidate = result.brdf(library), result.candidate(0, library)
    other = tb.render_basis(library, scene().probe.rotated(turn(120)), scene().view, "sampled", samples=256)
    record.add("what is open: tables", {
        "brdf": table.values, "valid": table.valid, "brdf_std": result.brdf_std(library), "candidate": candidate.values,
    })  # fmt: skip
    record.add("what is open: images", {
        "image_std": result.image_std(scene().basis), "image_std, other light": result.image_std(other),
    })  # fmt: skip
    for name, told in {"with cells": estimate.observability(library), "without": estimate.observability()}.items():
        shown = {field.name: getattr(told, field.name) for field in fields(told)}
        record.add(f"what is open: observability/{name}", {**shown, "verdict": told.verdict})


def alignment(record: Record) -> None:
    """Rotations found near the start, from another start, about the vertical axis, with blur and exposure."""
    library, probe, view = scene().few, scene().probe, scene().view
    photograph = tb.render(scene().whole.table(OTHER), probe.rotated(turn(3)), view, samples=1024, seed=3)
    mask = view.mask & (numbers(3, *view.size) < 0.9)
    searches: dict[str, dict[str, Any]] = {
        "near": {}, "masked": {"mask": mask}, "from a start": {"start": turn(2)}, "full": {"search": "full"},
        "with blur": {"blur": True}, "with exposure": {"exposure": True}, "with white balance": {"white_balance": True},
    }  # fmt: skip
    for name, options in searches.items():
        found = tb.align(1.5 * photograph, probe, view, library, **options)
        exposure = {} if found.exposure is None else {"factors": found.exposure.factors, "std": found.exposure.std}
        record.add(f"alignment/{name}", {
            "rotation": found.rotation, "covariance": found.covariance, "log odds": found.log_odds, "blur": found.blur,
            "basis": found.basis.packed, "probe": found.probe.radiance, "converged": found.converged,
            "evaluations": found.evaluations, "angle": found.angle, "uncertainty": found.uncertainty,
            "confident": found.confident, "str": str(found), **exposure,
        })  # fmt: skip


def analytic_fits(record: Record) -> None:
    """Every model; every metric; what else a fit of tables, of a reconstruction and of a photograph takes."""
    table = scene().whole.table(OTHER)
    for model in MODELS:
        record.add(f"analytic fits: models/{model}", _fit(tb.fit_analytic(table, model, most_evaluations=40)))
    for metric in METRICS:
        record.add(f"analytic fits: metrics/{metric}", _fit(tb.fit_analytic(table, "ward", metric)))
    found = tb.fit_analytic(table)
    estimate = tb.BRDFEstimator(scene().basis, scene().classes)
    std = 0.1 * table.values.abs() + 0.01
    record.add("analytic fits: tables, reconstruction", {
        "table": found.table.values, "str": str(found),
        "separate": _fit(tb.fit_analytic(table, "ggx", shared=False)),
        "from a start": _fit(tb.fit_analytic(table, "ggx", "log", start=found)),
        "uncertain": _fit(tb.fit_analytic(table, "ggx", uncertainty=std, largest_angle_deg=70)),
        "few evaluations": _fit(tb.fit_analytic(table, "principled", most_evaluations=3)),
        "of a reconstruction": _fit(tb.fit_analytic(estimate(scene().photograph), library=scene().library)),
    })  # fmt: skip
    few = scene().few.subset(scene().few.names[:4])
    record.add("analytic fits: batch", _fits(tb.fit_analytic_batch(few, "ggx", progress=False)))
    photograph, probe, view = scene().photograph, scene().probe, scene().view
    mask = view.mask & (numbers(4, *view.size) < 0.9)
    record.add("analytic fits: photograph", {
        "ggx": _fit(tb.fit_analytic_to_image(photograph, probe, view)),
        "ward, masked": _fit(tb.fit_analytic_to_image(photograph, probe, view, "ward", mask=mask, most_evaluations=30)),
        "adam": _fit(tb.fit_analytic_to_image(photograph, probe, view, method="adam", most_evaluations=40)),
        "from a start": _fit(tb.fit_analytic_to_image(photograph, probe, view, start=found, shared=False)),
    })  # fmt: skip


def _fit(fit: tb.AnalyticFit) -> dict[str, Any]:
    """All but the seconds that it took."""
    towards = [directions(seed, 500, front=True) for seed in (5, 6)]
    found = {field.name: getattr(fit, field.name) for field in fields(fit) if field.name not in ("seconds", "history")}
    history = [(step.evaluations, step.loss) for step in fit.history]
    return found | {"history": torch.tensor(history, dtype=torch.float64), "f_r": fit.f_r(*towards)}


def _fits(found: Sequence[tb.AnalyticFit]) -> dict[str, Any]:
    return {fit.name: _fit(fit) for fit in found}
