"""Several photographs of one material, solved together."""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._lit_sight import Inputs, LitSight, lit_sight
from torchbrdf.commands._photographs import Photograph
from torchbrdf.commands._reconstruction import Fit, Setting, fit_of, summary, weights_record
from torchbrdf.commands._results import (
    check_inputs_stay,
    obsolete,
    products,
    say_doubts_of,
    write_table,
    write_views,
    written,
)
from torchbrdf.commands._said import Said, in_record, kept, say
from torchbrdf.commands._weights import WEIGHTS, write_weights
from torchbrdf.estimation import Reconstruction
from torchbrdf.files import writing_folder
from torchbrdf.photograph import Observation
from torchbrdf.progress import told_if_slow
from torchbrdf.report import Grade, in_words
from torchbrdf.transport import BasisImages


def fit_together(options: argparse.Namespace, photographs: Sequence[Photograph], findings: Findings) -> int:
    """Explain photographs of one material by one table in `options.output`, beside views of each; returns 0."""
    names = [one.name for one in photographs]
    check_inputs_stay(options, [options.output], names)
    with writing_folder(options.output, WEIGHTS, obsolete(options.output)) as folder:
        inputs = Inputs(options)
        with told_if_slow(f"reading {len(names)} photographs and their light, and finding what they show"):
            lits = [lit_sight(one.its(options), inputs) for one in photographs]
        with told_if_slow(f"explaining {len(names)} photographs together by the library"):
            whole, fits = _solved(options, inputs, lits)
        write_table(folder, fits[0], options.uncertainty)
        said: dict[Photograph, list[Said]] = {one: [] for one in photographs}
        grades: list[Grade | None] = []
        for one, lit, fitted in zip(photographs, lits, fits, strict=True):
            with told_if_slow(f"making what belongs to {one.path}"), kept(said[one]):
                grades.append(write_views(folder, lit, fitted, one.its(options), one.name))
                if options.no_report:
                    say_doubts_of(fitted)
        _say(said)
        views = [
            {"name": name, "relative_error": float(fitted.result.relative_error)}
            | {"normal_coverage": fitted.subject.basis.normal_coverage}
            for name, fitted in zip(names, fits, strict=True)
        ]
        files = products(options, names)
        rest = {"primaries": options.primaries, "photographs": views, "files": files}
        write_weights(folder, weights_record(whole) | rest)
    for lit, fitted, grade in zip(lits, fits, grades, strict=True):
        judged = "" if grade is None else f"; {grade}"
        findings.line(f"photograph {lit.about}; relative error {float(fitted.result.relative_error):.2%}{judged}")
        findings.line(f"light {lit.light}; {fitted.subject.basis.description}")
    for lit in lits:
        if lit.found is not None:
            findings.line(lit.found)
    findings.line(summary(whole))
    findings.line(f"wrote {options.output}/{in_words(files)}")
    findings.add_files(*(options.output / file for file in files))
    if options.json:
        told = [
            written(
                one.path, options.output, products(options, [one.name]), in_record(said[one]), fitted, one.name, grade
            )
            | {"relative_error": fitted.result.relative_error}
            for one, fitted, grade in zip(photographs, fits, grades, strict=True)
        ]
        findings.add(photographs=told, joint_relative_error=whole.result.relative_error)
    return 0


def _solved(options: argparse.Namespace, inputs: Inputs, lits: Sequence[LitSight]) -> tuple[Fit, list[Fit]]:
    """What explains all photographs, and the same as each of them shows it; with one table."""
    estimates = inputs.estimates
    bases = [lit.basis or estimates.basis(lit.probe, lit.view) for lit in lits]
    estimator = estimates.estimator(bases)
    settings = [
        Setting(lit.probe, lit.view, basis, estimator, inputs.library) for lit, basis in zip(lits, bases, strict=True)
    ]
    seen = [lit.observation for lit in lits]
    result = estimator([one.image for one in seen], [one.mask for one in seen])
    parts = [
        replace(result, image=result.image[i]) if options.robust else seen_in(result, i, one, basis)
        for i, (one, basis) in enumerate(zip(seen, bases, strict=True))
    ]
    fits = [fit_of(*each) for each in zip(seen, parts, settings, strict=True)]
    first = estimates.combined(fits[:1])[0] if options.no_report else fits[0]
    fits = [replace(one, combined=first.table) for one in fits]
    return fit_of(seen[0], result, settings[0]), fits


def seen_in(result: Reconstruction, i: int, observation: Observation, basis: BasisImages) -> Reconstruction:
    """The result of several photographs with the errors that it and the classes leave on one of them."""
    used = basis.pack(observation.mask)[0]
    y, images = basis.pack(observation.image)[:, used].double(), basis.packed[..., used].double()
    weights = torch.cat([result.weights[None], result.class_weights]).double()
    residual = torch.einsum("kns,nsp->ksp", weights, images) - y
    errors = residual.square().sum((-2, -1)).to(result.error)
    image = result.image[i]
    return replace(
        result, image=image, error=errors[0], class_errors=errors[1:], energy=y.square().sum().to(result.energy)
    )


def _say(said: dict[Photograph, list[Said]]) -> None:
    """What holds of every photograph once, the rest with its name."""
    first, *others = said.values()
    common = [each for each in first if all(each in other for other in others)]
    say(common)
    for one, found in said.items():
        say(each.about(one.path) for each in found if each not in common)
