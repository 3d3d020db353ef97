"""The cases of scripts/benchmark_published_fits.py: one material, published fits and ours in the same metrics.

A pure function that runs in any process of a sweep.
"""

from pathlib import Path
from typing import Any

import torch
from published_fits import PublishedFit, read_published
from rotation_tasks import open_library

from torchbrdf.analytic_fit import LARGEST_ANGLE_DEG, fit_analytic
from torchbrdf.brdf_metrics import METRICS
from torchbrdf.merl import MerlTable
from torchbrdf.table_residuals import TableResiduals, fit_cells


def published_error(fit: PublishedFit, table: MerlTable, metric: str) -> float:
    """E of `analytic_fit` over all cells."""
    cells = fit_cells((1, 1, 1), LARGEST_ANGLE_DEG, torch.float32)
    residuals = TableResiduals.to(table, cells, metric, None)
    return float(residuals.of(fit.f_r(cells.geometry).float()).double().square().sum().sqrt())


def compare_case(library: str, material: str, file: str, digest: str, library_path: str, fits: str) -> dict[str, Any]:
    """Errors of a published fit and of ours with the same model, in every metric.

    file     of published fits, in the folder `fits`; digest of its content
    returns  metric -> published, ours (None where torchbrdf lacks the model), converged
    """
    table = open_library(library_path, library).table(material)
    fit = read_published(Path(fits) / file)[material]
    found = {}
    for metric in METRICS:
        ours = None if fit.model is None else fit_analytic(table, fit.model, metric)
        found[metric] = {
            "published": published_error(fit, table, metric),
            "ours": None if ours is None else ours.error,
            "converged": None if ours is None else ours.converged,
        }
    return found
