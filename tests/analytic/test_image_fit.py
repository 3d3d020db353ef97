"""Inverse rendering: planted parameters come back from a photograph, by both methods; masks; bad input."""

import math
import re
from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from bsdf_cases import numbers
from torchbrdf.analytic import image_fit as analytic_image_fit
from torchbrdf.analytic._gradient_descent import descend
from torchbrdf.analytic._image_residuals import ImageResiduals
from torchbrdf.analytic._least_squares import climb_out, minimise
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.cell_transport import CellTransport
from torchbrdf.analytic.image_fit import PIXELS, fit_analytic_to_image, image_error
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.analytic.table_fit import AnalyticFit
from torchbrdf.analytic.variables import FitVariables

GGX = numbers(diffuse=(0.3, 0.2, 0.1), specular=(0.05, 0.04, 0.06), roughness=0.15)
NEAR = numbers(diffuse=0.25, specular=0.08, roughness=0.22)
PROBE, VIEW = tb.LightProbe.default(64), tb.SphereView(14)


@pytest.fixture(scope="module")
def transport() -> CellTransport:
    return CellTransport.build(PROBE, VIEW)


def picture(transport: CellTransport, model: str, parameters: dict[str, Tensor]) -> Tensor:
    """(3, H, W)."""
    return VIEW.unpack(transport.render(MODELS[model].evaluate(parameters, transport.geometry)).T)


@pytest.fixture(scope="module")
def photograph(transport: CellTransport) -> Tensor:
    return picture(transport, "ggx", GGX)


@pytest.fixture(scope="module")
def rendered() -> Tensor:
    """By the renderer of tables, with other samples."""
    fit = AnalyticFit("ggx", GGX, "l2", 0, True, 0, 0, 0)
    return tb.render(fit.table, PROBE, VIEW, samples=4096, seed=9)


def assert_parameters(fit: AnalyticFit, wanted: dict[str, Tensor], rtol: float) -> None:
    for name, value in wanted.items():
        torch.testing.assert_close(fit.parameters[name], value, rtol=rtol, atol=rtol / 10, msg=f"{name}: {fit}")


def test_planted_parameters_come_back(rendered: Tensor):
    """From starts that know nothing, without being handed a transport, within the noise of the rendering."""
    fit = fit_analytic_to_image(rendered, PROBE, VIEW)
    assert_parameters(fit, GGX, 0.02)
    assert fit.error < 0.02
    assert fit.converged
    assert (fit.model, fit.metric, fit.warnings, fit.at_bounds) == ("ggx", PIXELS, (), ())
    assert fit.evaluations >= fit.iterations >= 1
    assert fit.seconds > 0
    assert all(value.dtype == torch.float64 for value in fit.parameters.values())


@pytest.mark.parametrize(
    ("model", "truth"),
    [
        ("metallic-roughness", numbers(base_color=(0.8, 0.5, 0.2), metallic=0.6, roughness=0.5)),
        ("ward", numbers(diffuse=(0.3, 0.2, 0.1), specular=(0.02, 0.1, 0.2), roughness=0.2)),
        ("lambert", numbers(diffuse=(0.3, 0.2, 0.1))),
    ],
)
def test_other_models(transport: CellTransport, model: str, truth: dict[str, Tensor]):
    fit = fit_analytic_to_image(picture(transport, model, truth), PROBE, VIEW, model, transport=transport)
    assert_parameters(fit, truth, 2e-3)
    assert fit.error < 1e-3


def test_gradient_descent_finds_them_too(photograph: Tensor, transport: CellTransport):
    settings = {"start": NEAR, "method": "adam", "transport": transport, "most_evaluations": 300}
    fit = fit_analytic_to_image(photograph, PROBE, VIEW, **settings)
    assert_parameters(fit, GGX, 0.03)
    assert fit.error < 0.01
    assert fit.evaluations == fit.iterations <= 300


def test_least_squares_take_fewer_steps(photograph: Tensor, transport: CellTransport):
    settings = {"start": NEAR, "transport": transport, "most_evaluations": 30}
    fits = [
        fit_analytic_to_image(photograph, PROBE, VIEW, method=method, **settings)
        for method in ("least-squares", "adam")
    ]
    assert fits[0].converged
    assert fits[0].error < 0.1 * fits[1].error


def test_separate_channels(transport: CellTransport):
    truth = {**GGX, "roughness": torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)}
    image = picture(transport, "ggx", truth)
    fit = fit_analytic_to_image(image, PROBE, VIEW, start=NEAR, shared=False, transport=transport)
    assert_parameters(fit, truth, 5e-3)


def test_error_is_the_relative_difference_of_pixels(photograph: Tensor, transport: CellTransport):
    fit = fit_analytic_to_image(photograph, PROBE, VIEW, "lambert", transport=transport)
    shown = picture(transport, "lambert", fit.parameters)[:, VIEW.mask[0]].double()
    y = photograph[:, VIEW.mask[0]].double()
    weight = 1 / (y + y.mean())
    assert fit.error == pytest.approx(float((weight * (shown - y)).norm() / (weight * y).norm()), rel=1e-3)
    assert fit.error > 0.05


def test_exposure_changes_nothing(photograph: Tensor, transport: CellTransport):
    """Photograph and light times a number."""
    bright = CellTransport.build(PROBE.scaled(1e3), VIEW)
    once = fit_analytic_to_image(photograph, PROBE, VIEW, "lambert", transport=transport)
    fit = fit_analytic_to_image(1e3 * photograph, PROBE.scaled(1e3), VIEW, "lambert", transport=bright)
    assert_parameters(fit, once.parameters, 1e-2)
    assert fit.error == pytest.approx(once.error, rel=1e-2)


def test_masked_pixels_say_nothing(photograph: Tensor, transport: CellTransport):
    """Nor do those outside the view."""
    mask = VIEW.mask.clone()
    mask[:, :, 8:] = False
    settings = {"start": NEAR, "transport": transport}
    clean = fit_analytic_to_image(photograph, PROBE, VIEW, mask=mask, **settings)
    assert_parameters(clean, GGX, 2e-3)
    for garbage in (float("nan"), float("inf"), 1e6):
        dirty = torch.where(mask & VIEW.mask, photograph, garbage)
        fit = fit_analytic_to_image(dirty, PROBE, VIEW, mask=torch.ones_like(mask) & mask, **settings)
        assert all(torch.equal(fit.parameters[name], clean.parameters[name]) for name in GGX)
        assert fit.error == clean.error


def test_start_of_a_fit(photograph: Tensor, transport: CellTransport):
    known = AnalyticFit("ggx", GGX, "l2", 0, True, 0, 0, 0)
    fit = fit_analytic_to_image(photograph, PROBE, VIEW, start=known, transport=transport)
    assert next(one.evaluations for one in fit.history if one.loss < 1e-8) <= 3
    assert fit.error < 1e-4


def test_same_fit_twice_and_no_random_numbers(photograph: Tensor):
    torch.manual_seed(3)
    before = torch.random.get_rng_state()
    one, other = (fit_analytic_to_image(photograph, PROBE, VIEW, "lambert") for _ in range(2))
    assert torch.equal(one.parameters["diffuse"], other.parameters["diffuse"])
    assert one.error == other.error
    assert torch.equal(torch.random.get_rng_state(), before)


@pytest.mark.parametrize("method", ["least-squares", "adam"])
def test_within_other_code(photograph: Tensor, transport: CellTransport, method: str):
    """Gradients off, and a photograph that is part of a graph; torch is left as it was."""
    threads = torch.get_num_threads()
    with torch.no_grad():
        fit = fit_analytic_to_image(
            photograph.clone().requires_grad_(),
            PROBE,
            VIEW,
            start=NEAR,
            method=method,
            transport=transport,
            most_evaluations=10,
        )
    assert fit.error < fit.history[0].loss ** 0.5
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize("method", ["least-squares", "adam"])
def test_in_inference_mode(photograph: Tensor, method: str):
    """Also with a transport that was made there, and a photograph; outside it serves gradients after."""
    settings = {"start": NEAR, "method": method, "most_evaluations": 4}
    with torch.inference_mode():
        transport = CellTransport.build(PROBE, VIEW, samples=64)
        within = fit_analytic_to_image(photograph.clone(), PROBE, VIEW, transport=transport, **settings)
    alone = fit_analytic_to_image(photograph, PROBE, VIEW, transport=transport, **settings)
    for name, value in alone.parameters.items():
        assert torch.equal(within.parameters[name], value)


@pytest.mark.parametrize("method", ["least-squares", "adam"])
def test_failure_to_converge_is_said(photograph: Tensor, transport: CellTransport, method: str):
    fit = fit_analytic_to_image(
        photograph, PROBE, VIEW, start=NEAR, method=method, transport=transport, most_evaluations=1
    )
    assert not fit.converged
    assert fit.warnings == ("not converged after 1 evaluations; raise --most-evaluations (most_evaluations in Python)",)
    assert fit.evaluations == 1


def test_bounds_are_said(photograph: Tensor, transport: CellTransport):
    fit = fit_analytic_to_image(100 * photograph, PROBE, VIEW, "lambert", transport=transport)
    assert fit.at_bounds == ("diffuse at its upper bound 1",)
    (warning,) = fit.warnings
    assert warning.startswith("a relative error of 96% of the pixels (diffuse at its upper bound 1): lambert cannot")


def test_errors_before_and_after_are_in_one_unit(photograph: Tensor, transport: CellTransport):
    mask = VIEW.mask.clone()
    mask[:, :, 8:] = False
    start = AnalyticFit("ggx", NEAR, "l2", 0, True, 0, 0, 0)
    once = fit_analytic_to_image(photograph, PROBE, VIEW, mask=mask, start=start, transport=transport)
    assert image_error(once, photograph, transport, mask) == pytest.approx(once.error, abs=1e-6)
    assert image_error(start, photograph, transport, mask) > 10 * once.error
    black = replace(start, parameters={name: torch.zeros_like(value) for name, value in start.parameters.items()})
    assert image_error(black, photograph, transport, mask) == pytest.approx(1, abs=1e-2)


@pytest.mark.parametrize("search", [descend, minimise])
def test_minimum_is_the_best_that_was_seen(photograph: Tensor, transport: CellTransport, search):
    variables = FitVariables(MODELS["ggx"])
    residuals = ImageResiduals.of_image(photograph, transport)
    start = variables.vector(NEAR)
    before = start.copy()
    found = search(variables, start, residuals, 4)
    assert (start == before).all()
    assert found.evaluations == 4 >= found.iterations
    assert not found.converged
    losses = [one.loss for one in found.history]
    assert losses == sorted(losses, reverse=True)
    assert found.loss == pytest.approx(losses[-1], rel=1e-6)
    at = variables.evaluate(torch.from_numpy(found.x), residuals.geometry)
    assert float(residuals.of(at).double().square().sum()) == pytest.approx(found.loss, rel=1e-5)
    lower, upper = variables.bounds
    assert ((lower <= found.x) & (found.x <= upper)).all()


def test_descent_stops_where_nothing_falls(photograph: Tensor, transport: CellTransport):
    variables = FitVariables(MODELS["lambert"])
    found = descend(variables, variables.starts[0], ImageResiduals.of_image(photograph, transport), 600)
    best = minimise(variables, variables.starts[0], ImageResiduals.of_image(photograph, transport), 50)
    assert found.converged
    assert found.evaluations < 600
    assert best.converged
    assert found.loss == pytest.approx(best.loss, rel=1e-2)
    assert found.loss >= best.loss * (1 - 1e-5)


@dataclass(frozen=True)
class TwoValleys:
    """Residuals of the albedo with valleys at 0.03, near the lower bound, and at 0.3; in `best` they are 0."""

    geometry: ShadingGeometry
    best: float

    def of(self, f_r: Tensor) -> Tensor:
        albedo = math.pi * f_r
        return torch.cat([(albedo - 0.03) * (albedo - 0.3), 0.005 * (albedo - self.best)])

    def along(self, f_r: Tensor, tangents: Tensor) -> Tensor:
        albedo = math.pi * f_r
        slopes = torch.cat([2 * albedo - 0.33, torch.full_like(albedo, 0.005)])
        return math.pi * slopes * tangents.repeat(1, 2, 1)


UPRIGHT = ShadingGeometry.of_directions(*torch.eye(3, dtype=torch.float64)[2].expand(2, 1, 3))


def test_a_second_search_climbs_out_of_a_valley():
    variables, residuals = FitVariables(MODELS["lambert"]), TwoValleys(UPRIGHT, 0.3)
    held = minimise(variables, variables.vector(numbers(diffuse=0.01)), residuals, 50)
    assert held.converged
    assert (held.x < 0.05).all()
    free = climb_out(variables, held, residuals, 100)
    assert free.x == pytest.approx(0.3, rel=1e-3)
    assert free.loss < 1e-6 * held.loss
    assert free.evaluations > held.evaluations
    assert free.history[: len(held.history)] == held.history
    assert [one.loss for one in free.history] == sorted((one.loss for one in free.history), reverse=True)
    assert sorted(one.seconds for one in free.history) == [one.seconds for one in free.history]


def test_a_minimum_stays_where_the_second_search_finds_nothing_better():
    variables, residuals = FitVariables(MODELS["lambert"]), TwoValleys(UPRIGHT, 0.03)
    first = minimise(variables, variables.vector(numbers(diffuse=0.01)), residuals, 50)
    both = climb_out(variables, first, residuals, 100)
    assert both.x is first.x
    assert (both.loss, both.converged, both.history) == (first.loss, first.converged, first.history)
    assert both.evaluations > first.evaluations
    assert both.seconds > first.seconds


@pytest.mark.parametrize(("most", "first"), [(31, 16), (30, 15), (2, 1)])
def test_least_squares_search_again_from_the_best_end(
    photograph: Tensor, transport: CellTransport, monkeypatch: pytest.MonkeyPatch, most: int, first: int
):
    ends, seen = [], []

    def search(variables, start, residuals, most_evaluations):
        ends.append(minimise(variables, start, residuals, most_evaluations))
        seen.append(most_evaluations)
        return ends[-1]

    def again(variables, found, residuals, most_evaluations):
        seen.append((found, most_evaluations))
        return replace(found, x=0.9 * found.x, evaluations=found.evaluations + 3)

    monkeypatch.setattr(analytic_image_fit, "minimise", search)
    monkeypatch.setattr(analytic_image_fit, "climb_out", again)
    fit = fit_analytic_to_image(photograph, PROBE, VIEW, transport=transport, most_evaluations=most)
    best = min(ends, key=lambda end: end.loss)
    assert len(ends) > 1
    assert seen == [first] * len(ends) + [(best, most)]
    assert fit.evaluations == sum(end.evaluations for end in ends) + 3
    wanted = FitVariables(MODELS["ggx"]).parameters(torch.from_numpy(0.9 * best.x))
    assert all(torch.equal(fit.parameters[name], wanted[name]) for name in wanted)


def test_a_start_of_numbers(photograph: Tensor, transport: CellTransport):
    start = {"diffuse": 0.3, "specular": 0.04, "roughness": 0.2}
    by_tensors = {name: torch.tensor([value], dtype=torch.float64) for name, value in start.items()}
    first, second = (
        fit_analytic_to_image(photograph, PROBE, VIEW, "ggx", start=one, transport=transport, most_evaluations=8)
        for one in (start, by_tensors)
    )
    torch.testing.assert_close(first.parameters, second.parameters, rtol=1e-6, atol=1e-7)


def test_black_pictures_are_one(photograph: Tensor, transport: CellTransport):
    residuals = ImageResiduals.of_image(photograph, transport)
    black = residuals.of(torch.zeros(len(transport.cells), 3))
    assert float(black.square().sum()) == pytest.approx(1, rel=1e-5)


def test_bad_arguments(photograph: Tensor, transport: CellTransport):
    def fails(message: str, image: Tensor = photograph, view: tb.SphereView = VIEW, **settings: object) -> None:
        with pytest.raises(ValueError, match="^" + re.escape(message)):
            fit_analytic_to_image(image, view=view, **{"probe": PROBE, "transport": transport, **settings})

    broken = photograph.clone()
    broken[1, 7, 7] = float("nan")
    fails("the photograph has NaN or infinite pixels; mask them out", broken)
    fails("the photograph is black where the mask is True, or nothing is; there is nothing to fit", 0 * photograph)
    fails("the photograph is black where the mask is True, or nothing is; there is nothing to fit", mask=~VIEW.mask)
    fails("the photograph must be (3, 14, 14) as the view, got (1, 3, 14, 14)", photograph[None])
    fails("the photograph must be (3, 14, 14) as the view, got (3, 24, 24)", torch.ones(3, 24, 24))
    fails("the photograph must be a tensor, got ndarray; see torch.from_numpy", photograph.numpy())
    fails("mask must be a tensor, got ndarray; see torch.from_numpy", mask=VIEW.mask.numpy())
    fails("the photograph must be float32 or float64 linear radiance, got torch.uint8", photograph.byte())
    fails("the photograph must be float32 or float64 linear radiance, got torch.bfloat16", photograph.bfloat16())
    fails("the photograph is below 0 on average where the mask is True, which no radiance is", -photograph)
    fails("start must be parameters by their names, or a fit, got list; of a reconstruction fit_analytic(", start=[0.5])
    fails("mask must be bool (1, 14, 14), got torch.float32 (1, 14, 14)", mask=VIEW.mask.float())
    fails("mask must be bool (1, 14, 14), got torch.bool (14, 14)", mask=VIEW.mask[0])
    fails("method must be 'adam' or 'least-squares', got 'bfgs'", method="bfgs")
    fails("no analytic model 'phong'; there are lambert, ", model="phong")
    order = "the order is tb.fit_analytic_to_image(image, probe, view)"
    fails(f"tb.fit_analytic_to_image: probe must be a LightProbe, got a SphereView; {order}", probe=VIEW, view=PROBE)
    fails("most_evaluations must be at least 1, got 0", most_evaluations=0)
    fails("most_evaluations must be at least 1, got -3", most_evaluations=-3)
    fails("ggx needs the parameters diffuse, specular, roughness, got diffuse", start=numbers(diffuse=0.5))
    fit = AnalyticFit("lambert", numbers(diffuse=0.5), "l2", 0, True, 0, 0, 0)
    fails("the start is a fit of lambert; give one of ggx, or model='lambert'", start=fit)
    apart = replace(fit, model="ggx", parameters={**GGX, "roughness": torch.ones(3)})
    fails("roughness of ggx must be 1 number with shared=True, got (3,)", start=apart)
    fails("the transport was built for another probe; make it anew: CellTransport.build(", probe=PROBE.scaled(2))
    fails(
        "the transport was built for SphereView(14, orthographic, ",
        torch.ones(3, 24, 24),
        tb.SphereView(24),
    )
