"""The cases of scripts/benchmarks/published_fits.py: one material, published fits and ours in the same metrics.

A pure function that runs in any process of a sweep.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from published_fit_files import PublishedFit, read_published
from torchbrdf.analytic import fit_analytic
from torchbrdf.analytic.table_fit import LARGEST_ANGLE_DEG
from torchbrdf.analytic.table_residuals import TableResiduals, fit_cells
from torchbrdf.brdf import METRICS, MerlTable
from torchbrdf.experiments import open_library


def published_error(fit: PublishedFit, table: MerlTable, metric: str) -> float:
    """E of `fit_analytic` over all cells."""
    cells = fit_cells((1, 1, 1), LARGEST_ANGLE_DEG, torch.float32)
    return TableResiduals.of_table(table, cells, metric).error(fit.f_r(cells.geometry).float())


def compare_case(
    library: str, material: str, files: Mapping[str, str], library_path: str, fits: str
) -> dict[str, dict[str, Any]]:
    """Errors of published fits of one model and of ours, in every metric.

    files    of published fits, in the folder `fits` -> digests of their content
    returns  metric -> published, a mapping of files; ours (None where torchbrdf lacks the model); converged
    """
    table = open_library(library_path, library).table(material)
    published = {file: read_published(Path(fits) / file)[material] for file in files}
    model = next(iter(published.values())).model
    found = {}
    for metric in METRICS:
        ours = None if model is None else fit_analytic(table, model, metric)
        found[metric] = {
            "published": {file: published_error(fit, table, metric) for file, fit in published.items()},
            "ours": None if ours is None else ours.error,
            "converged": None if ours is None else ours.converged,
        }
    return found
