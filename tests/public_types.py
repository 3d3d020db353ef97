"""What a type checker sees of the public names although they load lazily. mypy reads it in CI; nothing runs it."""

from pathlib import Path
from typing import assert_type

from torch import Tensor

import torchbrdf as tb
from torchbrdf.analytic import MODELS, AnalyticModel
from torchbrdf.mitsuba_backend import load_mitsuba


def from_a_photograph_to_a_table(path: Path) -> None:
    """The README's example."""
    library = tb.MaterialLibrary.default()
    probe = tb.LightProbe.open("probe.hdr", layout="angular")
    view = tb.SphereView(32)
    basis = tb.render_basis(library, probe, view)
    estimate = tb.BRDFEstimator(basis, tb.MaterialClasses.fit(library), penalty="paper", constraint="convex")
    result = estimate(tb.read_image(path))
    assert_type(library, tb.MaterialLibrary)
    assert_type(probe, tb.LightProbe)
    assert_type(basis, tb.BasisImages)
    assert_type(tb.read_image(path), Tensor)
    assert isinstance(result, tb.Reconstruction)
    assert_type(result.brdf(library), tb.MerlTable)
    assert_type(tb.align(tb.read_image(path), probe, view, library), tb.Alignment)
    assert_type(tb.render(result.brdf(library), probe, view), Tensor)
    assert_type(tb.LightProbe.open("x.hdr", "mirror_ball", circle=(8, 8, 8), reflectance=(0.5, 0.6, 1)), tb.LightProbe)
    assert_type(tb.__version__, str)
    assert_type(MODELS["ggx"], AnalyticModel)
    load_mitsuba()


def what_a_checker_refuses() -> None:
    """mypy complains where one of these comments is no longer needed."""
    tb.LightProbe.open("probe.hdr", layout="cube")  # type: ignore[arg-type]
    tb.LightProbe.open("probe.hdr", rows="middle")  # type: ignore[arg-type]
    tb.no_such_name  # type: ignore[attr-defined] # noqa: B018
