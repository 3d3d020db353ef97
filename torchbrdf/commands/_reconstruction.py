"""A photograph becomes a table: what `fit`, `live` and `demo` share."""

import argparse
import json
import warnings
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from torchbrdf.brdf import MaterialLibrary, MerlTable
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.commands._inputs import RESULT, about, open_camera, open_view
from torchbrdf.estimation import DEFAULT_PENALTY, BRDFEstimator, Constraint, MaterialClasses, Penalty, Reconstruction
from torchbrdf.files import writing
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, write_image
from torchbrdf.light import LightProbe
from torchbrdf.photograph import (
    LARGEST_DEFAULT_SIZE,
    Circle,
    Observation,
    Photograph,
    find_ball,
    find_circle,
    observe,
    observe_view,
)
from torchbrdf.rendering import render_basis
from torchbrdf.report import Subject, write_report
from torchbrdf.transport import BasisImages
from torchbrdf.view import SphereView, View

_SMALL_SHARE = 0.25
"""Of the view's pixels: with fewer the command warns."""


@dataclass(frozen=True)
class Sight:
    """What is seen of the shape, and how it was found there.

    about  for people: how the file was read, the silhouette, the pixels used
    """

    observation: Observation
    view: View
    about: str


def read_observation(options: argparse.Namespace, size: int | None) -> Sight:
    """The photograph, its mask and circle, resampled to `size`, and the shape that it shows."""
    photograph = Photograph.open(
        options.photo,
        options.mask,
        invert_mask=options.invert_mask,
        allow_ldr=options.allow_ldr,
        layer=options.layer,
        primaries=options.primaries,
        encoding=options.encoding,
    )
    if options.view == "sphere":
        observation, view, silhouette = _ball(options, photograph, size)
    else:
        if options.circle is not None:
            raise ValueError(f"--circle is for a ball, and --view is {options.view}")
        view = open_view(options, size or min(LARGEST_DEFAULT_SIZE, photograph.image.shape[-1]))
        with about(options.photo):
            observation = observe_view(photograph.image, view, photograph.usable)
        silhouette = f"shape of {options.view}"
    used, seen = int(observation.mask.sum()), len(view.pixels)
    if used < _SMALL_SHARE * seen:
        warnings.warn(f"{options.photo}: only {used} of the shape's {seen} pixels are used", UserWarning, stacklevel=2)
    height, width = view.size
    read = f" ({'; '.join(photograph.about)})" if photograph.about else ""
    return Sight(
        observation,
        view,
        f"{options.photo}{read}: {silhouette}; {used} of its {seen} pixels used, at {height} x {width}",
    )


def _ball(options: argparse.Namespace, photograph: Photograph, size: int | None) -> tuple[Observation, View, str]:
    """What a photograph shows of a ball, the view of it, and where its silhouette comes from."""
    with about(options.photo):
        camera = open_camera(options, photograph.size)
        silhouette, origin = _silhouette(options, photograph, camera)
        observation = observe(photograph.image, silhouette, photograph.usable, size)
        ball = silhouette if isinstance(silhouette, Ball) else None
        view = open_view(options, observation.image.shape[-1], ball)
    seen = "" if ball is None else f", {ball.off_axis_deg:.1f} degrees off the axis of a {ball.camera}"
    return observation, view, f"{silhouette}, {origin}{seen}"


def _silhouette(
    options: argparse.Namespace, photograph: Photograph, camera: PinholeCamera | None
) -> tuple[Circle | Ball, str]:
    """Where the ball is, and how that was found."""
    if options.circle is not None:
        circle = Circle(*options.circle)
        if circle.leaves(*photograph.size):
            message = f"{options.photo}: --circle, {circle}, leaves the photograph on opposite sides"
            warnings.warn(message, UserWarning, stacklevel=2)
        return circle if camera is None else Ball.of_circle(camera, *options.circle), "as given"
    with about(options.mask or options.photo):
        if camera is None:
            found: Circle | Ball = find_circle(photograph.size, photograph.mask, photograph.window)
        else:
            found = find_ball(camera, photograph.mask, photograph.window)
    if photograph.mask is not None:
        return found, "of the mask"
    return found, "as large as " + ("the photograph" if photograph.window is None else "what was recorded")


@dataclass(frozen=True)
class Fit:
    """An observation and what came of it."""

    observation: Observation
    view: View
    basis: BasisImages
    classes: MaterialClasses
    estimator: BRDFEstimator
    result: Reconstruction
    table: MerlTable

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
    """Render the basis, solve, and expand the table.

    penalty, constraint, robust  as `BRDFEstimator` takes them
    view   default: an orthographic sphere
    basis  rendered before, with this library, probe and view
    """
    view = view or SphereView(observation.image.shape[-1])
    basis = basis or render_basis(library, probe, view, progress=True)
    classes = MaterialClasses.fit(library)
    estimator = BRDFEstimator(basis, classes, penalty, constraint=constraint, library=library, robust=robust)
    result = estimator(observation.image, observation.mask)
    return Fit(observation, view, basis, classes, estimator, result, result.brdf(library))


def write_results(
    folder: Path,
    fitted: Fit,
    probe: LightProbe,
    library: MaterialLibrary,
    settings: dict[str, str],
    primaries: ColourSpace = DEFAULT_SPACE,
) -> None:
    """Write brdf.binary, weights.json, fitted.exr and report.html into a folder; warns of all that the report does."""
    fitted.table.save(folder / RESULT)
    write_image(folder / "fitted.exr", fitted.image, primaries=primaries)
    with writing(folder / "weights.json") as path:
        path.write_text(json.dumps({**weights_record(fitted), "primaries": primaries}, indent=1) + "\n")
    seen = fitted.observation
    subject = Subject(seen.image, seen.mask, fitted.result, fitted.basis, library, probe, fitted.view)
    description = settings | {
        "penalty": str(fitted.estimator.penalty),
        "constraint": str(fitted.estimator.constraint or "none"),
        "outliers": "left out" if fitted.estimator.robust else "used",
        "classes": f"{fitted.classes.sizes} basis BRDFs",
    }
    observability = fitted.estimator.observability(library)
    for warning in write_report(folder / "report.html", subject, description, observability=observability):
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
        "normal_coverage": fitted.basis.normal_coverage,
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
