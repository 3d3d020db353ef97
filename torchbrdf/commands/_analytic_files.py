"""What `torchbrdf analytic` prints of a fit, and the files beside that of the material."""

import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.analytic import AnalyticFit
from torchbrdf.brdf import RESULT_STD, MerlTable
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._refinement import Refinement
from torchbrdf.images import DISPLAY_SUFFIXES, ColourSpace, exposure_for, write_image
from torchbrdf.light import LightProbe
from torchbrdf.rendering import render_tables
from torchbrdf.view import SphereView

_SAMPLES = 1024
"""Of a pixel of the preview, on average."""


def uncertainty_of(brdf: Path, findings: Findings) -> Tensor | None:
    """The standard deviation of every cell that `torchbrdf fit --uncertainty` left in a folder."""
    if not (brdf / RESULT_STD).is_file():
        return None
    findings.line(f"cells weigh by their standard deviation in {brdf / RESULT_STD}")
    return MerlTable.open(brdf / RESULT_STD).values.clamp_min(0)


class Fits:
    """What was fitted, each told as it comes.

    all      fits, in the order of the preview; records: what a script is told of them
    labels   what each is, for people
    """

    def __init__(self, findings: Findings, refinement: Refinement | None, most_evaluations: int | None) -> None:
        """None yet.

        refinement        on a photograph; None: fits of a table are the last word
        most_evaluations  of that; None: its own
        """
        self._findings, self._refinement, self._most = findings, refinement, most_evaluations
        self.all: list[AnalyticFit] = []
        self.records: list[dict[str, Any]] = []
        self.labels: list[str] = []

    def tell(self, fit: AnalyticFit) -> AnalyticFit:
        """A fit of the table, and what it became on the photograph, which is given back."""
        self._add(fit, None)
        if self._refinement is None:
            return fit
        path, before = self._refinement.path, self._refinement.error(fit)
        self._findings.line(f"refined from there on {path}, where its relative error is {before:.2%} (pixels):", True)
        refined = self._refinement.refined(fit, self._most)
        self._add(refined, path, before)
        return refined

    def _add(self, fit: AnalyticFit, photograph: Path | None, before: float | None = None) -> None:
        _tell(fit, self._findings)
        self.all.append(fit)
        self.records.append(_record(fit) | {"photograph": photograph, "relative_error_before": before})
        self.labels.append(fit.model if photograph is None else f"{fit.model} refined")


def write_preview(
    path: Path, table: MerlTable, fits: Fits, probe: LightProbe, size: int, primaries: ColourSpace
) -> None:
    """Spheres side by side under a probe: the table, and each fit; to look at, exposed for the table's highlight."""
    view = SphereView(size)
    pictures = render_tables([table, *(fit.table for fit in fits.all)], probe, view, _SAMPLES)
    exposure = exposure_for(pictures[0], view.mask) if path.suffix.lower() in DISPLAY_SUFFIXES else 1.0
    write_image(path, torch.cat(list(pictures), dim=-1) * exposure, primaries=primaries)


def _tell(fit: AnalyticFit, findings: Findings) -> None:
    """Its lines, and its warnings."""
    bounds = [f"  at a bound: {bound}" for bound in fit.at_bounds]
    effort = f"  {fit.iterations} iterations, {fit.evaluations} evaluations of the model, {fit.seconds:.1f} s"
    findings.line("\n".join([str(fit), effort, *bounds]), at_once=True)
    for warning in fit.warnings:
        warnings.warn(f"{fit.name}, {fit.model}: {warning}", UserWarning, stacklevel=2)


def _record(fit: AnalyticFit) -> dict[str, Any]:
    """What a script is told of it."""
    return {
        "model": fit.model,
        "parameters": fit.parameters,
        "metric": fit.metric,
        "relative_error": fit.error,
        "converged": fit.converged,
        "iterations": fit.iterations,
        "evaluations": fit.evaluations,
        "seconds": fit.seconds,
        "at_bounds": fit.at_bounds,
        "warnings": fit.warnings,
    }
