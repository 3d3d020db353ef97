"""Inverse rendering of an analytic BRDF: its parameters straight from a photograph, by our own transport.

It minimises `image_residuals` between the photograph and the rendering of the parameters. From a start that knows
nothing this search is long, and may end in a wrong valley (docs/analytic.md); `fit_analytic` of a reconstruction is a
start that knows.
"""

import time
from typing import Literal

import torch
from torch import Tensor

from torchbrdf.analytic._gradient_descent import descend
from torchbrdf.analytic._image_residuals import ImageResiduals
from torchbrdf.analytic._least_squares import Minimum, climb_out, minimise
from torchbrdf.analytic.catalogue import model_of
from torchbrdf.analytic.cell_transport import CellTransport
from torchbrdf.analytic.settings import MOST_ON_A_PHOTOGRAPH
from torchbrdf.analytic.table_fit import DEFAULT_MODEL, AnalyticFit, Start, serial_operations, starting_points
from torchbrdf.analytic.variables import FitVariables
from torchbrdf.arguments import check_types
from torchbrdf.light import LightProbe
from torchbrdf.view import View

PIXELS = "pixels"
"""The metric of these fits: relative difference of the pixels."""

POOR_PICTURE = 0.2
"""Relative error of the pixels above which a fit warns: `principled` has 0.18 of a golden car paint under Uffizi."""

Method = Literal["adam", "least-squares"]
MOST_EVALUATIONS = {"adam": 600, "least-squares": MOST_ON_A_PHOTOGRAPH}


def fit_analytic_to_image(
    image: Tensor,
    probe: LightProbe,
    view: View,
    model: str = DEFAULT_MODEL,
    *,
    mask: Tensor | None = None,
    start: Start | None = None,
    method: Method = "least-squares",
    shared: bool = True,
    most_evaluations: int | None = None,
    transport: CellTransport | None = None,
) -> AnalyticFit:
    """The parameters of an analytic BRDF whose rendering is most like a photograph.

    image      (3, H, W)  linear radiance
    view       of the photographed shape, H x W
    mask       (1, H, W)  bool, True = use
    start      parameters, tensors or numbers, or a fit of the same model to a reconstruction; None: several starts that
               know nothing. Numbers at or beyond a bound of `MODELS[model].parameters` are moved inside it, by 1e-4
               (least squares) or 1e-3 (Adam) of the range, on the scale of the search (logarithms where the model
               says so)
    method     "adam", gradient descent as inverse rendering uses it, or "least-squares", which takes fewer steps
    shared     parameters that are no colours are the same for R, G and B
    most_evaluations  of the model from each start; None: 600 or 100. Least squares keep at least half of them for a
               second search from the best end, moved inside the bounds: the first may have ended in a valley
    transport  `CellTransport.build(probe, view)`, to render many photographs or starts with
    Raises ValueError for shapes and types that do not fit, a photograph that is black, negative, NaN or infinite, or an
    unknown method.
    """
    began = time.perf_counter()
    if method not in MOST_EVALUATIONS:
        raise ValueError(f"method must be {' or '.join(map(repr, MOST_EVALUATIONS))}, got {method!r}")
    most = MOST_EVALUATIONS[method] if most_evaluations is None else most_evaluations
    if most < 1:
        raise ValueError(f"most_evaluations must be at least 1, got {most}")
    variables = FitVariables(model_of(model), shared)
    image = _checked(image, probe, view, mask)
    transport = transport or CellTransport.build(probe, view)
    same_view = transport.view.fingerprint == view.fingerprint
    if not same_view or transport.probe != probe.fingerprint:
        other = "another probe" if same_view else f"{transport.view}, not for {view}"
        raise ValueError(f"the transport was built for {other}; make it anew: CellTransport.build(probe, view)")
    residuals = ImageResiduals.of_image(image, transport, mask)
    search, first = (descend, most) if method == "adam" else (minimise, (most + 1) // 2)
    with serial_operations():
        ends = [search(variables, x, residuals, first) for x in starting_points(variables, start)]
        ends.sort(key=lambda end: end.loss)
        if first < most:
            ends[0] = climb_out(variables, ends[0], residuals, most)
    best = ends[0]
    at_bounds = variables.at_bounds(best.x)
    return AnalyticFit(
        model=model,
        parameters=variables.parameters(torch.from_numpy(best.x)),
        metric=PIXELS,
        error=best.loss**0.5,
        converged=best.converged,
        iterations=best.iterations,
        evaluations=sum(end.evaluations for end in ends),
        seconds=time.perf_counter() - began,
        at_bounds=at_bounds,
        warnings=_warnings(best, most, model, at_bounds),
        name="photograph",
        history=best.history,
    )


def image_error(fit: AnalyticFit, image: Tensor, transport: CellTransport, mask: Tensor | None = None) -> float:
    """Relative difference of the pixels of a fit from a photograph's, whatever it was fitted to."""
    return ImageResiduals.of_image(image, transport, mask).error(fit.model, fit.parameters)


def _warnings(best: Minimum, most: int, model: str, at_bounds: tuple[str, ...]) -> tuple[str, ...]:
    """What to know of the end of a search: of one that was not over, no more than that."""
    if not best.converged:
        advice = "raise --most-evaluations (most_evaluations in Python)"
        return (f"not converged after {most} evaluations; {advice}",)
    error = best.loss**0.5
    if error <= POOR_PICTURE:
        return ()
    bounds = f" ({', '.join(at_bounds)})" if at_bounds else ""
    return (
        f"a relative error of {error:.0%} of the pixels{bounds}: {model} cannot look like this photograph, or the "
        "light, its scale or the outline of the shape is wrong",
    )


def _checked(image: Tensor, probe: LightProbe, view: View, mask: Tensor | None) -> Tensor:
    for what, values in (("the photograph", image), ("mask", mask)):
        if values is not None and not isinstance(values, Tensor):
            raise ValueError(f"{what} must be a tensor, got {type(values).__name__}; see torch.from_numpy")
    check_types("tb.fit_analytic_to_image", image=(image, Tensor), probe=(probe, LightProbe), view=(view, View))
    if image.shape != (3, *view.size):
        raise ValueError(f"the photograph must be {(3, *view.size)} as the view, got {tuple(image.shape)}")
    if image.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"the photograph must be float32 or float64 linear radiance, got {image.dtype}")
    if mask is not None and (mask.shape != view.mask.shape or mask.dtype != torch.bool):
        raise ValueError(f"mask must be bool {tuple(view.mask.shape)}, got {mask.dtype} {tuple(mask.shape)}")
    used = view.pack(image) if mask is None else image[:, (view.mask & mask)[0]]
    if not bool(torch.isfinite(used).all()):
        raise ValueError("the photograph has NaN or infinite pixels; mask them out")
    if bool(used.mean() < 0):
        raise ValueError("the photograph is below 0 on average where the mask is True, which no radiance is")
    if not bool(used.mean() > 0):
        raise ValueError("the photograph is black where the mask is True, or nothing is; there is nothing to fit")
    return image.detach().cpu()
