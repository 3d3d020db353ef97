"""Analytic fits of tables: planted truth, what the error is, what is ignored, and what is said of bad input."""

import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from math import cos, pi, radians

import numpy as np
import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from bsdf_cases import direction_pairs, interior, numbers
from torchbrdf.analytic import table_fit
from torchbrdf.analytic._least_squares import Progress, best_of, minimise
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.analytic.table_fit import AnalyticFit, fit_analytic, fit_analytic_batch, most_alike, serial_operations
from torchbrdf.analytic.table_residuals import TableResiduals, fit_cells
from torchbrdf.analytic.variables import FitVariables
from torchbrdf.brdf.directions import from_half_difference
from torchbrdf.brdf.merl import GRID, above_horizon, cell_centres
from torchbrdf.brdf.metrics import METRICS, cell_measure
from torchbrdf.rendering.tables import render_tables

COARSE = (2, 18, 22)
"""Every so many cells of theta_h, theta_d and phi_d."""

STEPS = table_fit._STEPS

WARD = numbers(diffuse=(0.3, 0.2, 0.1), specular=(0.05, 0.2, 0.4), roughness=0.15)
GGX = numbers(diffuse=(0.3, 0.2, 0.1), specular=(0.05, 0.04, 0.06), roughness=0.12)
NEAR_GGX = numbers(diffuse=(0.25, 0.25, 0.15), specular=(0.06, 0.06, 0.06), roughness=0.2)


@pytest.fixture(scope="module", autouse=True)
def few_cells() -> Iterator[None]:
    """A fit looks at a third of its cells, which is enough to tell two fits apart."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table_fit, "_STEPS", (1, 9, 22))
        yield


@pytest.fixture
def its_own_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit looks at the cells that it looks at."""
    monkeypatch.setattr(table_fit, "_STEPS", STEPS)


@pytest.fixture(scope="module")
def planted() -> Callable[[str, Mapping[str, Tensor]], tb.MerlTable]:
    """The table of a model."""
    valid = above_horizon()
    geometry = ShadingGeometry.of_angles(*(angle.expand(GRID)[valid] for angle in cell_centres()))

    def make(model: str, parameters: Mapping[str, Tensor]) -> tb.MerlTable:
        values = torch.zeros(*GRID, 3, dtype=torch.float64)
        values[valid] = MODELS[model].evaluate(parameters, geometry)
        return tb.MerlTable(values, valid, f"{model} of {model}")

    return make


@pytest.fixture(scope="module")
def ward(planted) -> tb.MerlTable:
    return planted("ward", WARD)


@pytest.fixture(scope="module")
def ggx(planted) -> tb.MerlTable:
    return planted("ggx", GGX)


@pytest.fixture(scope="module")
def misfit(ward: tb.MerlTable) -> AnalyticFit:
    """Ward as GGX: there is an error."""
    return fit_analytic(ward, "ggx", start=NEAR_GGX)


def assert_parameters(fit: AnalyticFit, wanted: Mapping[str, Tensor], rtol: float = 1e-3) -> None:
    assert list(fit.parameters) == list(wanted)
    for name, value in wanted.items():
        torch.testing.assert_close(fit.parameters[name], value, rtol=rtol, atol=rtol / 10, msg=f"{name}: {fit}")


def same(one: AnalyticFit, other: AnalyticFit) -> bool:
    """Bit by bit."""
    equal = [torch.equal(one.parameters[name], other.parameters[name]) for name in one.parameters]
    return all(equal) and (one.error, one.evaluations, one.metric) == (other.error, other.evaluations, other.metric)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("model", [name for name in MODELS if name != "rough-plastic"])
def test_every_model_comes_back_in_every_metric(model: str, metric: str):
    """From its own starts, on few cells."""
    truth = interior(model)
    if model.endswith("-dielectric"):
        truth["eta"] = torch.tensor([1.8], dtype=torch.float64)  # at 8, F is flat: its size and the weight are one
    cells = fit_cells(COARSE, 80.0, torch.float64)
    values = torch.zeros(*GRID, 3, dtype=torch.float64)
    values.reshape(-1, 3)[cells.index] = MODELS[model].evaluate(truth, cells.geometry)
    residuals = TableResiduals.of_table(tb.MerlTable(values, above_horizon()), cells, metric)
    variables = FitVariables(MODELS[model])
    with serial_operations():
        tried = sorted((minimise(variables, x, residuals, 8) for x in variables.starts), key=lambda one: one.loss)
        found = best_of([minimise(variables, one.x, residuals, 200) for one in tried[:2]])
    assert found.converged
    assert found.loss**0.5 < 1e-4
    for name, value in variables.parameters(torch.from_numpy(found.x)).items():
        torch.testing.assert_close(value, truth[name], rtol=1e-2, atol=1e-3, msg=f"{name}: {value}")


@pytest.mark.parametrize(
    ("model", "metric"), [("ggx", "cube-root"), ("ward", "l2"), ("oren-nayar", "log"), ("rough-conductor", "cube-root")]
)
@pytest.mark.usefixtures("its_own_cells")
def test_planted_parameters_come_back(planted, model: str, metric: str):
    """The whole way."""
    truth = {"ggx": GGX, "ward": WARD}.get(model, interior(model))
    fit = fit_analytic(planted(model, truth), model, metric)
    assert_parameters(fit, truth)
    assert fit.error < 1e-4
    assert fit.converged
    assert (fit.model, fit.metric, fit.warnings, fit.at_bounds) == (model, metric, (), ())
    assert fit.name == f"{model} of {model}"
    assert fit.evaluations >= fit.iterations >= 1
    assert fit.seconds > 0
    assert all(value.dtype == torch.float64 for value in fit.parameters.values())


def test_plastic_comes_back_from_nearby(monkeypatch: pytest.MonkeyPatch):
    """A table of the cells that the fit looks at, and the error over these: each takes long."""
    monkeypatch.setattr(table_fit, "_ALL", table_fit._STEPS)
    truth = numbers(diffuse=(0.5, 0.3, 0.1), specular=(1.0, 0.9, 0.8), eta=1.5, roughness=0.2)
    start = {**truth, "roughness": torch.tensor([0.25]), "diffuse": torch.tensor([0.3])}
    cells = fit_cells(table_fit._STEPS, 80.0, torch.float64)
    values, valid = torch.zeros(*GRID, 3, dtype=torch.float64), torch.zeros(GRID, dtype=torch.bool)
    values.view(-1, 3)[cells.index] = MODELS["rough-plastic"].evaluate(truth, cells.geometry)
    valid.view(-1)[cells.index] = True
    fit = fit_analytic(tb.MerlTable(values, valid), "rough-plastic", start=start, most_evaluations=12)
    assert fit.error < 1e-3
    assert_parameters(fit, truth, 1e-2)


def brute_force(fit: AnalyticFit, table: tb.MerlTable, metric: str, weight: Tensor | float = 1.0) -> float:
    """E over the whole grid, cell by cell, from directions."""
    w_i, w_o = from_half_difference(*cell_centres())
    limit = cos(radians(80))
    used = table.valid & (w_i[..., 2] > limit) & (w_o[..., 2] > limit)
    w_i, w_o = w_i[used], w_o[used]

    def g(f_r: Tensor) -> Tensor:
        x = f_r * w_i[..., 2:]
        return {"l2": x, "log": torch.log(1 + x), "cube-root": (x + 1e-8) ** (1 / 3) - 1e-8 ** (1 / 3)}[metric]

    measure = (cell_measure()[..., None] * weight)[used]
    wanted = g(table.values[used])
    difference = (measure * (g(fit.f_r(w_i, w_o)) - wanted) ** 2).sum()
    return float((difference / (measure * wanted**2).sum()) ** 0.5)


@pytest.mark.parametrize("metric", METRICS)
def test_error_is_that_of_the_whole_grid(ward: tb.MerlTable, metric: str):
    valid = ward.valid.clone()
    valid[:, 30:34] = False
    fit = fit_analytic(replace(ward, valid=valid), "ggx", metric, start=NEAR_GGX)
    assert fit.error > 0.02
    assert fit.error == pytest.approx(brute_force(fit, replace(ward, valid=valid), metric), rel=1e-3)
    assert f"relative error {fit.error:.2%} ({metric})" in str(fit)


def test_no_nearby_parameters_are_better(ward: tb.MerlTable, misfit: AnalyticFit):
    """In the error over all cells, of which the fit saw few: within what that costs."""
    everywhere = TableResiduals.of_table(ward, fit_cells((1, 1, 1), 80.0, torch.float32), "cube-root")
    for name, value in misfit.parameters.items():
        for factor in (0.95, 1.05):
            moved = MODELS["ggx"].evaluate({**misfit.parameters, name: value * factor}, everywhere.geometry)
            assert everywhere.error(moved) > misfit.error * (1 - 1e-4), (name, factor)


def test_history_falls_to_the_loss(misfit: AnalyticFit):
    losses = [one.loss for one in misfit.history]
    assert len(losses) > 3
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] ** 0.5 == pytest.approx(misfit.error, rel=0.1)
    evaluations, seconds = zip(*((one.evaluations, one.seconds) for one in misfit.history), strict=True)
    assert list(evaluations) == sorted(set(evaluations))
    assert list(seconds) == sorted(seconds)
    assert evaluations[-1] <= misfit.evaluations
    assert 0 <= seconds[-1] <= misfit.seconds


def test_channels_that_change_places(ward: tb.MerlTable, misfit: AnalyticFit):
    turned = fit_analytic(
        replace(ward, values=ward.values[..., [2, 0, 1]]),
        "ggx",
        start={**NEAR_GGX, "diffuse": NEAR_GGX["diffuse"][[2, 0, 1]]},
    )
    wanted = {name: value[[2, 0, 1]] if len(value) == 3 else value for name, value in misfit.parameters.items()}
    assert_parameters(turned, wanted)
    assert turned.error == pytest.approx(misfit.error, rel=1e-4)


def test_twice_the_table_is_twice_the_colours(ward: tb.MerlTable):
    once, twice = (fit_analytic(replace(ward, values=k * ward.values), "cook-torrance", "l2") for k in (1, 2))
    assert once.error > 0.005, "an exact fit would show less"
    for name in ("diffuse", "specular"):
        torch.testing.assert_close(twice.parameters[name], 2 * once.parameters[name], rtol=0.01, atol=1e-3)
    assert twice.error == pytest.approx(once.error, rel=1e-3)


def test_separate_channels_are_as_if_alone(planted):
    """Three roughnesses; each channel's parameters are those of a grey table of it."""
    rough = {**GGX, "roughness": torch.tensor([0.1, 0.2, 0.4], dtype=torch.float64)}
    table = planted("ggx", rough)
    apart = fit_analytic(table, "ggx", shared=False)
    assert_parameters(apart, rough)
    together = fit_analytic(table, "ggx")
    assert together.parameters["roughness"].shape == (1,)
    assert 0.1 < float(together.parameters["roughness"]) < 0.4
    assert together.error > 10 * apart.error


def test_holes_say_nothing(ggx: tb.MerlTable):
    """Whatever lies in them."""
    valid = ggx.valid.clone()
    valid[:, 20:50] = False
    share = 1 - float(valid.sum() / ggx.valid.sum())
    garbage = torch.tensor([float("nan"), float("inf"), -7.0, 1e9]).double().repeat(GRID[2] // 4)[:, None]
    clean, dirty = (
        fit_analytic(tb.MerlTable(values, valid), "ggx", start=NEAR_GGX, uncertainty=values.abs())
        for values in (ggx.values, torch.where(valid[..., None], ggx.values, garbage))
    )
    assert same(clean, dirty)
    assert_parameters(clean, GGX)
    assert clean.warnings == (
        f"{share:.0%} of the cells above the horizon were not measured; the fit extrapolates there",
    )


@pytest.mark.usefixtures("its_own_cells")
@pytest.mark.parametrize("along", ["theta_h", "theta_d"])
def test_holes_where_the_fit_would_look(ggx: tb.MerlTable, along: str):
    valid = torch.zeros_like(ggx.valid)
    kept = (slice(0, None, 2),) if along == "theta_h" else (slice(None), slice(0, None, 3))
    valid[kept] = ggx.valid[kept]
    fit = fit_analytic(replace(ggx, valid=valid), "ggx", start=NEAR_GGX if along == "theta_d" else None)
    assert_parameters(fit, GGX)
    assert len(fit.warnings) == 1


def test_negative_cells_are_black_and_said(ggx: tb.MerlTable):
    values = ggx.values.clone()
    values[:, :, 86:94] = -1.0
    fit = fit_analytic(replace(ggx, values=values), "lambert")
    count = int(ggx.valid[:, :, 86:94].sum())
    assert fit.warnings == (f"{count} measured cells are negative and were taken as 0",)
    assert same(fit, fit_analytic(replace(ggx, values=values.clamp_min(0)), "lambert"))


def test_uncertain_cells_say_nothing(ggx: tb.MerlTable):
    uncertainty = torch.zeros(*GRID, 3, dtype=torch.float64)
    uncertainty[:, 10:40, :, 1] = 1e12
    garbage = torch.where(uncertainty > 0, 50.0, ggx.values)
    table = replace(ggx, values=garbage)
    assert_parameters(fit_analytic(table, "ggx", start=NEAR_GGX, uncertainty=uncertainty), GGX)
    fooled = fit_analytic(table, "ggx", start=NEAR_GGX)
    assert float(fooled.parameters["diffuse"][1]) > 0.5, "the garbage is no harm: the case shows nothing"


def test_weights_of_uncertain_cells(ward: tb.MerlTable):
    """A tenth halves a weight, a fifth leaves a fifth of it; the error that is returned counts all cells alike."""
    dim = torch.zeros(*GRID, 3, dtype=torch.float64)
    dim[:10] = 0.1 * ward.values[:10]
    dim[10:20] = 0.2 * ward.values[10:20]
    fit = fit_analytic(ward, "ggx", start=NEAR_GGX, uncertainty=dim)
    weight = torch.ones(*GRID, 3, dtype=torch.float64)
    weight[:10] = 0.5
    weight[10:20] = 0.2
    cells = fit_cells((1, 1, 1), 80.0, torch.float64)
    residuals = TableResiduals.of_table(ward, cells, "cube-root", lambda index: dim.reshape(-1, 3)[index])
    weighted = residuals.error(MODELS["ggx"].evaluate(fit.parameters, cells.geometry))
    assert weighted == pytest.approx(brute_force(fit, ward, "cube-root", weight), rel=1e-3)
    assert fit.error == pytest.approx(brute_force(fit, ward, "cube-root"), rel=1e-3)
    assert weighted == pytest.approx(fit.history[-1].loss ** 0.5, rel=0.1)
    assert weighted != pytest.approx(fit.error, rel=0.02)


def test_even_uncertainty_changes_nothing(ward: tb.MerlTable, misfit: AnalyticFit):
    uncertain = fit_analytic(ward, "ggx", start=NEAR_GGX, uncertainty=0.3 * ward.values)
    assert_parameters(uncertain, misfit.parameters)
    assert uncertain.error == pytest.approx(misfit.error, rel=1e-4)


def test_start_is_respected(ggx: tb.MerlTable):
    """It is the only one."""
    there = fit_analytic(ggx, "ggx", start=GGX)
    assert_parameters(there, GGX, 1e-5)
    assert there.evaluations <= 4
    assert_parameters(fit_analytic(ggx, "ggx", start=NEAR_GGX, most_evaluations=1), NEAR_GGX, 1e-12)


def test_start_outside_the_bounds_is_moved_inside(ggx: tb.MerlTable):
    fit = fit_analytic(ggx, "ggx", start=numbers(diffuse=5, specular=-1, roughness=9))
    assert_parameters(fit, GGX)


def test_batch_is_the_single_fits(ward: tb.MerlTable, ggx: tb.MerlTable):
    """Also of a library, which is told apart from tables."""
    tables = [ward, ggx]
    single = [fit_analytic(table, "ward", "log") for table in tables]
    batch = fit_analytic_batch(tables, "ward", "log", progress=False)
    assert [fit.name for fit in batch] == [table.name for table in tables]
    assert all(map(same, batch, single))
    library = tb.MaterialLibrary.from_tables(tables)
    for held, alone in zip(fit_analytic_batch(library, "ward", "log", progress=False), single, strict=True):
        assert held.name == alone.name
        assert_parameters(held, alone.parameters)
    assert fit_analytic_batch([], "ward", progress=False) == []


def test_a_bad_table_of_a_batch_is_named(ggx: tb.MerlTable):
    black = replace(ggx, values=0 * ggx.values, name="soot")
    with pytest.raises(ValueError, match=r"^soot: f_r is zero in every measured cell; there is nothing to fit$"):
        fit_analytic_batch([ggx, black], "lambert", progress=False)


def test_same_fit_twice_and_no_random_numbers(ward: tb.MerlTable, misfit: AnalyticFit):
    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    again = fit_analytic(ward, "ggx", start=NEAR_GGX)
    assert same(again, misfit)
    assert torch.equal(torch.random.get_rng_state(), before)


def test_failure_to_converge_is_said(ggx: tb.MerlTable):
    fit = fit_analytic(ggx, "ggx", most_evaluations=1)
    assert not fit.converged
    assert fit.warnings == ("not converged after 1 evaluations; raise --most-evaluations (most_evaluations in Python)",)
    assert str(fit).endswith("; NOT CONVERGED")
    assert np.isfinite(fit.error)


def test_evaluations_are_limited(ward: tb.MerlTable):
    assert fit_analytic(ward, "ggx", start=NEAR_GGX, most_evaluations=3).evaluations == 3


def test_parameters_at_their_bounds_are_said():
    white = tb.MerlTable.from_function(lambda i, o: torch.tensor([1.4, 0.5, 0.0]).expand_as(i) / pi)
    fit = fit_analytic(white, "lambert")
    assert fit.parameters["diffuse"].tolist() == pytest.approx([1, 0.5, 0], abs=1e-4)
    assert fit.at_bounds == (
        "diffuse of B at its lower bound 0",
        "diffuse of R at its upper bound 1",
    )
    assert fit.converged


def test_no_highlight_is_at_a_bound(planted):
    matte = planted("lambert", numbers(diffuse=(0.6, 0.3, 0.1)))
    fit = fit_analytic(matte, "ward")
    torch.testing.assert_close(fit.parameters["diffuse"], torch.tensor([0.6, 0.3, 0.1]).double(), rtol=1e-3, atol=0)
    assert any(bound.startswith("specular at its lower bound") for bound in fit.at_bounds)


@pytest.mark.parametrize("metric", METRICS)
def test_a_mirror(metric: str):
    """Light in the first row of theta_h only, which is narrower than any roughness."""
    values = torch.zeros(*GRID, 3, dtype=torch.float64)
    values[0] = 1e5
    fit = fit_analytic(tb.MerlTable(values, above_horizon(), "mirror"), "ggx", metric)
    assert np.isfinite(fit.error)
    assert float(fit.parameters["diffuse"].max()) < 1e-2
    assert fit.warnings[-1] == f"a relative error of {fit.error:.0%}: ggx cannot be such a material"


def test_grey_levels_of_the_darkest_material(ggx: tb.MerlTable):
    """A table of 1e-4 of the light: the cube root's offset must not show."""
    fit = fit_analytic(replace(ggx, values=1e-4 * ggx.values), "ward")
    bright = fit_analytic(ggx, "ward")
    torch.testing.assert_close(
        fit.parameters["diffuse"], 1e-4 * bright.parameters["diffuse"], rtol=0.05, atol=1e-7
    )


def test_image_metric_takes_the_best_by_a_rendering(ward: tb.MerlTable, monkeypatch: pytest.MonkeyPatch):
    """And says which it was."""
    monkeypatch.setattr(table_fit, "_JUDGE_SIZE", 20)
    monkeypatch.setattr(table_fit, "_judge", lru_cache(table_fit._judge.__wrapped__))
    fits = [fit_analytic(ward, "ggx", metric, start=NEAR_GGX) for metric in METRICS]
    chosen = fit_analytic(ward, "ggx", "image", start=NEAR_GGX)
    probe, view = tb.LightProbe.default(64), tb.SphereView(20)
    wanted, *shown = render_tables([ward, *(fit.table for fit in fits)], probe, view)[..., view.mask[0]]
    losses = [float(((one - wanted) / (wanted + wanted.mean())).norm()) for one in shown]
    assert max(losses) > 1.2 * min(losses), "all as good: the case shows nothing"
    best = fits[losses.index(min(losses))]
    assert same(chosen, best)
    assert chosen.metric == best.metric
    assert most_alike(fits, ward) is best
    assert most_alike(fits[::-1], ward) is best


def test_table_is_the_model(misfit: AnalyticFit):
    w_i, w_o = direction_pairs(200, lowest=0.05)
    direct = MODELS["ggx"].evaluate(misfit.parameters, ShadingGeometry.of_directions(w_i, w_o))
    torch.testing.assert_close(misfit.f_r(w_i, w_o), direct)
    looked_up = misfit.table.lookup(w_i, w_o, interpolation="linear")
    assert float((looked_up - direct).norm() / direct.norm()) < 0.05
    assert misfit.table.name == "ggx of ward of ward"
    assert bool(misfit.table.valid.eq(above_horizon()).all())
    below = w_i * torch.tensor([1.0, 1.0, -1.0])
    assert not misfit.f_r(below, w_o).any()
    assert misfit.f_r(w_i.float(), w_o.float()).dtype == torch.float32


def test_angles_beyond_the_largest_say_nothing(ggx: tb.MerlTable):
    w_i, w_o = from_half_difference(*cell_centres())
    grazing = torch.minimum(w_i[..., 2], w_o[..., 2]) < cos(radians(50))
    table = replace(ggx, values=torch.where(grazing[..., None], 3.0, ggx.values))
    assert_parameters(fit_analytic(table, "ggx", start=NEAR_GGX, largest_angle_deg=50), GGX)
    assert fit_analytic(table, "ggx", start=NEAR_GGX).error > 0.1


@pytest.mark.parametrize("place", [torch.no_grad, torch.inference_mode, torch.enable_grad])
def test_within_other_code(ggx: tb.MerlTable, place: type):
    """A table that is part of a graph, and gradients off."""
    values = ggx.values.clone().requires_grad_()
    with place():
        fit = fit_analytic(tb.MerlTable(values, ggx.valid), "ggx", start=NEAR_GGX, uncertainty=0.1 * values)
    assert_parameters(fit, GGX)
    assert not fit.parameters["diffuse"].requires_grad


def test_single_precision_tables(ggx: tb.MerlTable):
    assert_parameters(fit_analytic(replace(ggx, values=ggx.values.float()), "ggx", start=NEAR_GGX), GGX)


@pytest.mark.parametrize("batch", [False, True])
def test_threads_and_warnings_are_as_before(ggx: tb.MerlTable, batch: bool):
    """Also where it fails."""
    threadpoolctl = pytest.importorskip("threadpoolctl")
    before = torch.get_num_threads()

    def state() -> tuple[object, ...]:
        blas = [pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
        return torch.get_num_threads(), list(warnings.filters), blas

    torch.set_num_threads(3)
    try:
        known = state()
        for table in (ggx, replace(ggx, values=0 * ggx.values)):
            try:
                if batch:
                    fit_analytic_batch([table], "lambert", progress=False)
                else:
                    fit_analytic(table, "lambert")
            except ValueError:
                assert not table.values.any()
            assert state() == known
    finally:
        torch.set_num_threads(before)


def test_fits_warn_of_nothing_themselves(ggx: tb.MerlTable):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit_analytic(ggx, "ggx", start=NEAR_GGX)


def test_serial_operations_end_after_an_exception():
    before, filters = torch.get_num_threads(), list(warnings.filters)
    seen = []

    def interrupted() -> None:
        with serial_operations() as threads:
            seen.extend([threads, torch.get_num_threads()])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert seen == [before, 1]
    assert torch.get_num_threads() == before
    assert list(warnings.filters) == filters


@pytest.fixture(scope="module")
def reconstruction(tiny_library: tb.MaterialLibrary) -> tb.Reconstruction:
    """Of a rendering of a material of the library."""
    probe, view = tb.LightProbe.default(64), tb.SphereView(16)
    basis = tb.render_basis(tiny_library, probe, view, progress=False)
    estimator = tb.BRDFEstimator(basis, tb.MaterialClasses.fit(tiny_library, n_classes=1))
    return estimator(tb.render(tiny_library.table("satin-0.35"), probe, view))


def test_reconstructions(tiny_library: tb.MaterialLibrary, reconstruction: tb.Reconstruction):
    """They are weighted by their own uncertainty, or by one that is given."""
    table, std = reconstruction.brdf(tiny_library), reconstruction.brdf_std(tiny_library)
    own = fit_analytic(reconstruction, "ggx", library=tiny_library, start=NEAR_GGX)
    assert_parameters(own, fit_analytic(table, "ggx", uncertainty=std, start=NEAR_GGX).parameters, 1e-2)
    unweighted = fit_analytic(table, "ggx", start=NEAR_GGX)
    assert not same(own, unweighted)
    given = fit_analytic(reconstruction, "ggx", library=tiny_library, uncertainty=0 * std, start=NEAR_GGX)
    assert same(given, unweighted)
    certain = fit_analytic(replace(reconstruction, posteriors=None), "ggx", library=tiny_library, start=NEAR_GGX)
    assert same(certain, given)


def test_reconstructions_need_their_library(tiny_tables, reconstruction: tb.Reconstruction):
    message = "a Reconstruction is fitted with the library it was made with: pass library=..."
    with pytest.raises(ValueError, match=re.escape(message)):
        fit_analytic(reconstruction)
    other = tb.MaterialLibrary.from_tables(list(tiny_tables.values())[:3])
    with pytest.raises(ValueError, match="library"):
        fit_analytic(reconstruction, library=other)


def bad_uncertainty(value: float) -> Tensor:
    found = torch.zeros(*GRID, 3)
    found[20, 20, 90] = value
    return found


LIMITS = "of the cells that a fit looks at, with directions below 80 degrees, none was measured, holds light"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"model": "phong"}, "no analytic model 'phong'; there are lambert, ggx, "),
        ({"metric": "l1"}, "metric must be one of l2, log, cube-root, image, got 'l1'"),
        ({"most_evaluations": 0}, "most_evaluations must be at least 1, got 0"),
        ({"largest_angle_deg": 0}, "largest_angle_deg must be above 0 and at most 90, got 0"),
        ({"largest_angle_deg": 91}, "largest_angle_deg must be above 0 and at most 90, got 91"),
        ({"largest_angle_deg": float("nan")}, "largest_angle_deg must be above 0 and at most 90, got nan"),
        ({"uncertainty": torch.zeros(3)}, "uncertainty must be (90, 90, 180, 3), got (3,)"),
        (
            {"uncertainty": bad_uncertainty(float("nan"))},
            "uncertainty must be at least 0 in every measured cell; it is negative or NaN in 1",
        ),
        (
            {"uncertainty": bad_uncertainty(-1)},
            "uncertainty must be at least 0 in every measured cell; it is negative or NaN in 1",
        ),
        ({"uncertainty": torch.full((*GRID, 3), float("inf"))}, f"ggx of ggx: {LIMITS}"),
        ({"start": numbers(diffuse=0.5)}, "ggx needs the parameters diffuse, specular, roughness, got diffuse"),
        ({"start": {**GGX, "sheen": torch.ones(1)}}, "ggx needs the parameters diffuse, specular, roughness, got "),
        (
            {"start": {**GGX, "roughness": torch.ones(3)}},
            "roughness of ggx must be 1 number with shared=True, got (3,)",
        ),
        (
            {"start": {**GGX, "diffuse": torch.ones(2)}},
            "parameter diffuse of ggx must be (*batch, 1) or (*batch, 3), got (2,)",
        ),
        (
            {"start": numbers(diffuse=1, specular=1, roughness=-0.5)},
            "roughness of ggx must be positive numbers, got [-0.5]",
        ),
        (
            {"start": numbers(diffuse=float("nan"), specular=1, roughness=1)},
            "diffuse of ggx must be numbers, got [nan]",
        ),
    ],
)
def test_bad_arguments(ggx: tb.MerlTable, settings: dict[str, object], message: str):
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        fit_analytic(ggx, **settings)


def test_what_is_no_table():
    one = "must be a MerlTable, got 'gold.binary'; take result.brdf(library), library.table(name) or tb.read_table("
    with pytest.raises(ValueError, match="^" + re.escape(f"tb.fit_analytic: material {one}")):
        fit_analytic("gold.binary")
    with pytest.raises(ValueError, match="^" + re.escape(f"tb.fit_analytic_batch: materials {one}")):
        fit_analytic_batch(["gold.binary"], progress=False)


def test_tables_without_light(ggx: tb.MerlTable):
    black = replace(ggx, name="soot", values=0 * ggx.values)
    negative = replace(ggx, name="soot", values=-ggx.values)
    for table in (black, negative):
        with pytest.raises(ValueError, match=r"^soot: f_r is zero in every measured cell; there is nothing to fit$"):
            fit_analytic(table)
    grazing = torch.zeros_like(ggx.valid)
    grazing[:, 85:] = True
    with pytest.raises(ValueError, match=f"^ggx of ggx: {LIMITS}"):
        fit_analytic(replace(ggx, valid=grazing))


def test_the_repr_leaves_out_the_history():
    fit = AnalyticFit("ggx", GGX, "log", 0.1, True, 1, 1, 0.0, history=(Progress(1, 0.5, 0.25),) * 600)
    assert repr(fit).startswith("AnalyticFit(model='ggx', parameters={'diffuse': ")
    assert "Progress" not in repr(fit)


def test_public_names():
    for name in ("AnalyticFit", "fit_analytic", "fit_analytic_batch", "fit_analytic_to_image"):
        assert name in tb.__all__
        assert hasattr(tb, name)


def test_what_is_as_good_as_zero_is_printed_as_zero():
    """But for what is fitted as its logarithm, which may be small."""
    tiny = {"diffuse": torch.tensor([1.7e-22, 1.234567e-4, 0.25]), "specular": torch.tensor([0.04, 4e-7, 1.0])}
    fit = AnalyticFit("ggx", {**tiny, "roughness": torch.tensor([1e-3])}, "log", 0.1, True, 1, 1, 0.0)
    assert str(fit) == "ggx: diffuse 0 0.000123 0.25, specular 0.04 0 1, roughness 0.001; relative error 10.00% (log)"
