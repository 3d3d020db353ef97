"""An observation becomes a table: what `fit`, `live` and `demo` share."""

import json
import warnings
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from torchbrdf.brdf import MaterialLibrary, MerlTable
from torchbrdf.commands._inputs import RESULT
from torchbrdf.estimation import DEFAULT_PENALTY, BRDFEstimator, Constraint, MaterialClasses, Penalty, Reconstruction
from torchbrdf.files import writing
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, write_image
from torchbrdf.light import LightProbe
from torchbrdf.photograph import Observation
from torchbrdf.rendering import render_basis
from torchbrdf.report import Scene, Subject, write_report
from torchbrdf.transport import BasisImages
from torchbrdf.view import SphereView, View


@dataclass(frozen=True, eq=False)
class Fit:
    """An observation and what came of it."""

    subject: Subject
    classes: MaterialClasses
    estimator: BRDFEstimator

    @property
    def result(self) -> Reconstruction:
        """The weights."""
        return self.subject.result

    @property
    def table(self) -> MerlTable:
        """What they weigh, as one table."""
        return self.subject.tables[0]

    @property
    def image(self) -> Tensor:
        """(3, H, W): the photograph as the weights explain it."""
        image = self.result.image
        return image[0] if isinstance(image, tuple) else image


def fit(
    observation: Observation,
    probe: LightProbe,
    library: MaterialLibrary,
    penalty: Penalty = DEFAULT_PENALTY,
    view: View | None = None,
    basis: BasisImages | None = None,
    constraint: Constraint | None = None,
    robust: bool = False,
) -> Fit:
    """Render the basis and solve.

    penalty, constraint, robust  as `BRDFEstimator` takes them
    view   default: an orthographic sphere
    basis  rendered before, with this library, probe and view
    """
    view = view or SphereView(observation.image.shape[-1])
    basis = basis or render_basis(library, probe, view, progress=True)
    classes = MaterialClasses.fit(library)
    estimator = BRDFEstimator(basis, classes, penalty, constraint=constraint, library=library, robust=robust)
    result = estimator(observation.image, observation.mask)
    return Fit(Subject(observation.image, observation.mask, result, basis, library, probe, view), classes, estimator)


def write_results(
    folder: Path,
    fitted: Fit,
    settings: dict[str, str],
    primaries: ColourSpace = DEFAULT_SPACE,
    scene: Scene | None = None,
) -> None:
    """Write brdf.binary, weights.json, fitted.exr and report.html into a folder; warns of all that the report does."""
    fitted.table.save(folder / RESULT)
    write_image(folder / "fitted.exr", fitted.image, primaries=primaries)
    with writing(folder / "weights.json") as path:
        path.write_text(json.dumps({**weights_record(fitted), "primaries": primaries}, indent=1) + "\n")
    description = settings | {
        "penalty": str(fitted.estimator.penalty),
        "constraint": str(fitted.estimator.constraint or "none"),
        "outliers": "left out" if fitted.estimator.robust else "used",
        "classes": f"{fitted.classes.sizes} basis BRDFs",
    }
    observability = fitted.estimator.observability(fitted.subject.library)
    warned = write_report(folder / "report.html", fitted.subject, description, observability=observability, scene=scene)
    for warning in warned:
        warnings.warn(warning, UserWarning, stacklevel=2)


def weights_record(fitted: Fit) -> dict[str, object]:
    """weights.json: the settings, and the three weights (R, G and B of the result) of every basis BRDF used."""
    weights = fitted.result.weights
    used = weights.abs().sum(1).nonzero().ravel().tolist()
    names = fitted.result.names
    return {
        "class": int(fitted.result.class_index),
        "class_probabilities": fitted.result.class_probabilities.tolist(),
        "class_errors": fitted.result.class_errors.tolist(),
        "relative_error": float(fitted.result.relative_error),
        "penalty": fitted.estimator.penalty,
        "constraint": fitted.estimator.constraint,
        "robust": fitted.estimator.robust,
        "library": fitted.result.library,
        "normal_coverage": fitted.subject.basis.normal_coverage,
        "weights": [{"material": names[i // 3], "channel": "RGB"[i % 3], "weight": weights[i].tolist()} for i in used],
    }


def summary(fitted: Fit) -> str:
    """One line on what was found."""
    result = fitted.result
    j = int(result.class_index)
    if result.posteriors is None:
        what = f"class {j} of {fitted.classes.n_classes} ({fitted.classes.sizes[j]} basis BRDFs)"
    else:
        n_classes, probability = fitted.classes.n_classes, float(result.class_probabilities[j])
        what = f"most probable of {n_classes} classes: {j} ({fitted.classes.sizes[j]} basis BRDFs), {probability:.0%}"
    return f"{what}; relative error on the photograph {float(result.relative_error):.2%}"
