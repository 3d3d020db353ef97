"""From a measured or reconstructed table to the parameters of an analytic BRDF.

A fit minimises, over cells c of the MERL grid, with the map g of a metric (`brdf.METRICS`), the measure m of a cell and
the weight u of an uncertain value,

    E^2 = sum_c m_c u_c |g(f_r(c) cos theta_i) - g(f_r*(c) cos theta_i)|^2 / sum_c m_c u_c |g(f_r*(c) cos theta_i)|^2

within the bounds of the parameters, from several starts (`least_squares`).
"""

import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import nan

import numpy as np
import torch
from torch import Tensor

from torchbrdf.analytic._image_residuals import ImageResiduals
from torchbrdf.analytic._least_squares import Minimum, Progress, best_of, minimise
from torchbrdf.analytic.catalogue import model_of
from torchbrdf.analytic.cell_transport import CellTransport
from torchbrdf.analytic.settings import DEFAULT_METRIC, DEFAULT_MODEL, IMAGE_METRIC, MOST_EVALUATIONS
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.analytic.table_residuals import TableResiduals, Uncertainty, fit_cells
from torchbrdf.analytic.variables import FitVariables
from torchbrdf.arguments import check_types, several
from torchbrdf.brdf import GRID, METRICS, MaterialLibrary, MerlTable
from torchbrdf.estimation import Reconstruction
from torchbrdf.light import LightProbe
from torchbrdf.progress import progress_bar
from torchbrdf.threads import one_thread
from torchbrdf.view import SphereView

LARGEST_ANGLE_DEG = 80.0
"""Pairs with a direction further from the normal do not count: measurements there are poor [NDM05]."""

POOR = 0.5
"""Relative error above which a fit warns: of a mirror, say, of which a lobe has nothing."""

_SCREENING_EVALUATIONS = 8
"""Of each start, on few cells, before the best go on."""

_FINALISTS = 2
_SCREENING_STEPS, _STEPS, _FINER_STEPS, _ALL = (2, 9, 22), (1, 3, 22), (1, 1, 22), (1, 1, 1)
"""Every how many cells of theta_h, theta_d and phi_d the screening and the fit look at, what they look at where those
cells hold nothing, and the error."""

_JUDGE_SIZE = 48
"""Pixels along a side of the sphere by which metric="image" chooses."""


@dataclass(frozen=True, eq=False)
class AnalyticFit:
    """An analytic BRDF fitted to a table or a photograph.

    model        name of the model
    parameters   name -> (1,), or (3,) of one number a channel; float64
    metric       that was minimised; of metric="image" the one that was chosen
    error        E with all u = 1, over all measured cells below the largest angle; of a photograph over its pixels
    converged    the optimiser met its tolerance
    iterations   steps of the optimiser from the start that won; evaluations: of the model, from all starts
    seconds      it took
    at_bounds    parameters that ended at a bound, in words
    warnings     what to know before trusting the result, one line each
    name         of what was fitted
    history      the best loss E^2 after so many evaluations and seconds, from the start that won
    """

    model: str
    parameters: dict[str, Tensor]
    metric: str
    error: float
    converged: bool
    iterations: int
    evaluations: int
    seconds: float
    at_bounds: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    name: str = "unnamed"
    history: tuple[Progress, ...] = field(default=(), repr=False)

    def __str__(self) -> str:
        """One line: the model, its parameters, and how well it fits."""
        numbers = ", ".join(
            f"{p.name} {' '.join(p.printed(number) for number in self.parameters[p.name].tolist())}"
            for p in model_of(self.model).parameters
        )
        state = "" if self.converged else "; NOT CONVERGED"
        return f"{self.model}: {numbers}; relative error {self.error:.2%} ({self.metric}){state}"

    def f_r(self, w_i: Tensor, w_o: Tensor) -> Tensor:
        """f_r (..., 3) in 1/sr of unit vectors (..., 3) in the local frame, 0 where one is below the horizon."""
        geometry = ShadingGeometry.of_directions(*torch.broadcast_tensors(w_i.double(), w_o.double()))
        return model_of(self.model).evaluate(self.parameters, geometry).to(w_i.dtype)

    @property
    def shared(self) -> bool:
        """Whether the channels share every parameter that is no colour."""
        return all(p.colour or len(self.parameters[p.name]) == 1 for p in model_of(self.model).parameters)

    @cached_property
    def table(self) -> MerlTable:
        """The model on the MERL grid."""
        return MerlTable.from_function(self.f_r, f"{self.model} of {self.name}")


Start = Mapping[str, Tensor | float] | AnalyticFit
"""What a fit may start from: parameters by their names, or another fit."""


def fit_analytic(
    material: MerlTable | Reconstruction,
    model: str = DEFAULT_MODEL,
    metric: str = DEFAULT_METRIC,
    *,
    library: MaterialLibrary | None = None,
    shared: bool = True,
    start: Start | None = None,
    uncertainty: Tensor | None = None,
    largest_angle_deg: float = LARGEST_ANGLE_DEG,
    most_evaluations: int = MOST_EVALUATIONS,
) -> AnalyticFit:
    """Fit an analytic BRDF to a table or to a reconstruction.

    model        name in `analytic.MODELS`
    metric       "l2", "log" [LKYU12], "cube-root" [FFG12], or "image": the best of their fits by a rendering
    library      of a Reconstruction, which is then expanded and weighted by its own uncertainty
    shared       parameters that are no colours are the same for R, G and B; False: each channel has its own
    start        parameters to start from, (1,) or (3,) each, or a fit of the same model; None: several starts
    uncertainty  (90, 90, 180, 3) standard deviation of f_r in 1/sr: uncertain cells count less
    largest_angle_deg  pairs with a direction further from the normal do not count
    most_evaluations   of the model from each of the two best starts; the choice takes 8 more of every start
    Raises ValueError for an unknown model or metric, a table that is zero everywhere, or arguments that do not fit.
    """
    if isinstance(material, Reconstruction):
        if library is None:
            raise ValueError("a Reconstruction is fitted with the library it was made with: pass library=...")
        table = material.brdf(library)
        own = None if material.posteriors is None else _own_uncertainty(material, library)
    else:
        check_types("tb.fit_analytic", material=(material, MerlTable))
        table, own = material, None
    given = None if uncertainty is None else _given_uncertainty(uncertainty, table)
    search = _Search.of(model, shared, largest_angle_deg, most_evaluations, start)
    with serial_operations():
        return search.fit(table, metric, given or own)


def fit_analytic_batch(
    materials: Sequence[MerlTable] | MaterialLibrary,
    model: str = DEFAULT_MODEL,
    metric: str = DEFAULT_METRIC,
    *,
    shared: bool = True,
    largest_angle_deg: float = LARGEST_ANGLE_DEG,
    most_evaluations: int = MOST_EVALUATIONS,
    progress: bool = True,
) -> list[AnalyticFit]:
    """`fit_analytic` of many tables, or of every material of a library, side by side on all cores."""
    search = _Search.of(model, shared, largest_angle_deg, most_evaluations)
    if not isinstance(materials, MaterialLibrary):
        materials = several("tb.fit_analytic_batch", "materials", materials, MerlTable)
    count = len(materials)

    def one(i: int) -> AnalyticFit:
        table = materials.table(materials.names[i]) if isinstance(materials, MaterialLibrary) else materials[i]
        return search.fit(table, metric)

    with serial_operations() as threads, ThreadPoolExecutor(threads) as pool:
        fits = pool.map(one, range(count))
        return list(progress_bar(fits, total=count, desc=f"{model} fits", shown=progress))


@contextmanager
def serial_operations() -> Iterator[int]:
    """One thread for each operation of torch and BLAS, whose threads cost more than such small operations gain.

    Gives the number that torch had. Operations inside can be differentiated, whatever mode the caller is in.
    """
    from threadpoolctl import threadpool_limits

    with one_thread() as threads, threadpool_limits(1, user_api="blas"), warnings.catch_warnings():
        # torch.func, which rough-plastic needs, makes torch script functions of its own, of which torch then warns.
        warnings.filterwarnings("ignore", "`torch.jit.script` is deprecated", FutureWarning)
        with torch.inference_mode(False):
            yield threads


def _own_uncertainty(material: Reconstruction, library: MaterialLibrary) -> Uncertainty:
    """Of the cells that are asked for only: `brdf_std` of all takes ten seconds."""
    posterior = material.posterior
    return lambda index: posterior.std(library.rows(index)).T


def _given_uncertainty(uncertainty: Tensor, table: MerlTable) -> Uncertainty:
    if uncertainty.shape != (*GRID, 3):
        raise ValueError(f"uncertainty must be {(*GRID, 3)}, got {tuple(uncertainty.shape)}")
    std = uncertainty.detach().cpu()
    unsound = int((~(std[table.valid.cpu()] >= 0)).any(-1).sum())
    if unsound:
        raise ValueError(f"uncertainty must be at least 0 in every measured cell; it is negative or NaN in {unsound}")
    return lambda index: std.reshape(-1, 3)[index]


def starting_points(variables: FitVariables, start: Start | None) -> tuple[np.ndarray, ...]:
    """Vectors (V,) that a fit starts from: those of the model, or what is given, which must belong to it."""
    if start is None:
        return variables.starts
    if isinstance(start, AnalyticFit):
        if start.model != variables.model.name:
            raise ValueError(
                f"the start is a fit of {start.model}; give one of {variables.model.name}, or model={start.model!r}"
            )
        start = start.parameters
    if not isinstance(start, Mapping):
        raise ValueError(
            f"start must be parameters by their names, or a fit, got {type(start).__name__}; of a reconstruction "
            f'fit_analytic(result, "{variables.model.name}", library=...) makes a fit'
        )
    return (variables.vector({name: torch.atleast_1d(torch.as_tensor(value)) for name, value in start.items()}),)


def table_warnings(table: MerlTable) -> tuple[str, ...]:
    """What a fit of a table should say about it. Raises ValueError where it is zero everywhere."""
    red, green, blue = table.values.detach().unbind(-1)
    if not bool((((red > 0) | (green > 0) | (blue > 0)) & table.valid).any()):
        raise ValueError(f"{table.name}: f_r is zero in every measured cell; there is nothing to fit")
    found = []
    negative = int((((red < 0) | (green < 0) | (blue < 0)) & table.valid).sum())
    if negative:
        found.append(f"{negative} measured cells are negative and were taken as 0")
    missing = 1 - table.measured_share
    if missing > 0.01:
        found.append(f"{missing:.0%} of the cells above the horizon were not measured; the fit extrapolates there")
    return tuple(found)


def most_alike(fits: Sequence[AnalyticFit], table: MerlTable) -> AnalyticFit:
    """The fit whose sphere under the embedded probe is most like the table's, by `image_residuals`."""
    transport = _judge()
    shown = transport.render(transport.values(table))
    residuals = ImageResiduals.of_image(transport.view.unpack(shown.T), transport)
    return min(fits, key=lambda fit: residuals.error(fit.model, fit.parameters))


@lru_cache(maxsize=1)
def _judge() -> CellTransport:
    return CellTransport.build(LightProbe.default(), SphereView(_JUDGE_SIZE))


@dataclass(frozen=True)
class _Search:
    """Where and how long to look for the parameters of a model."""

    variables: FitVariables
    largest_angle_deg: float
    most_evaluations: int
    starts: tuple[np.ndarray, ...]

    @classmethod
    def of(
        cls,
        model: str,
        shared: bool,
        largest_angle_deg: float,
        most_evaluations: int,
        start: Start | None = None,
    ) -> "_Search":
        if not 0 < largest_angle_deg <= 90:
            raise ValueError(f"largest_angle_deg must be above 0 and at most 90, got {largest_angle_deg}")
        if most_evaluations < 1:
            raise ValueError(f"most_evaluations must be at least 1, got {most_evaluations}")
        variables = FitVariables(model_of(model), shared)
        return cls(variables, largest_angle_deg, most_evaluations, starting_points(variables, start))

    def fit(self, table: MerlTable, metric: str, uncertainty: Uncertainty | None = None) -> AnalyticFit:
        """The fit, and what is to be said about it."""
        began, remarks = time.perf_counter(), table_warnings(table)
        if metric not in (*METRICS, IMAGE_METRIC):
            raise ValueError(f"metric must be one of {', '.join((*METRICS, IMAGE_METRIC))}, got {metric!r}")
        fits = [self._fit(table, each, uncertainty) for each in (METRICS if metric == IMAGE_METRIC else [metric])]
        found = fits[0] if len(fits) == 1 else most_alike(fits, table)
        if not found.converged:
            advice = "raise --most-evaluations (most_evaluations in Python)"
            remarks = (*remarks, f"not converged after {self.most_evaluations} evaluations; {advice}")
        if found.error > POOR:
            remarks = (*remarks, f"a relative error of {found.error:.0%}: {found.model} cannot be such a material")
        return replace(found, seconds=time.perf_counter() - began, warnings=remarks)

    def _fit(self, table: MerlTable, metric: str, uncertainty: Uncertainty | None) -> AnalyticFit:
        def residuals(*grids: tuple[int, int, int]) -> TableResiduals:
            """On the first of the grids whose cells say anything: a table may have holes, or be a mirror."""
            for steps in grids:
                cells = fit_cells(steps, self.largest_angle_deg, torch.float64)
                found = TableResiduals.of_table(table, cells, metric, uncertainty)
                if found.any_light:
                    return found
            raise ValueError(
                f"{table.name}: of the cells that a fit looks at, with directions below {self.largest_angle_deg:g} "
                "degrees, none was measured, holds light and has a finite uncertainty; there is nothing to fit"
            )

        starts, tried = self.starts, list[Minimum]()
        if len(starts) > _FINALISTS:
            screen = residuals(_SCREENING_STEPS, _STEPS, _FINER_STEPS)
            tried = [minimise(self.variables, x, screen, _SCREENING_EVALUATIONS) for x in starts]
            starts = tuple(one.x for one in sorted(tried, key=lambda one: one.loss)[:_FINALISTS])
        fine = residuals(_STEPS, _FINER_STEPS)
        ends = [minimise(self.variables, x, fine, self.most_evaluations) for x in starts]
        everywhere = TableResiduals.of_table(table, fit_cells(_ALL, self.largest_angle_deg, torch.float32), metric)
        best = best_of(ends)
        return AnalyticFit(
            model=self.variables.model.name,
            parameters=self.variables.parameters(torch.from_numpy(best.x)),
            metric=metric,
            error=everywhere.error(self.variables.evaluate(torch.from_numpy(best.x), everywhere.geometry)),
            converged=best.converged,
            iterations=best.iterations,
            evaluations=sum(one.evaluations for one in (*tried, *ends)),
            seconds=nan,
            at_bounds=self.variables.at_bounds(best.x),
            name=table.name,
            history=best.history,
        )
