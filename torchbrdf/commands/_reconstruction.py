"""An observation becomes a table: what `fit`, `live` and `demo` share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import torch
from torch import Tensor

from torchbrdf.brdf import MaterialLibrary, MerlTable
from torchbrdf.estimation import (
    DEFAULT_PENALTY,
    BRDFEstimator,
    Constraint,
    MaterialClasses,
    Observability,
    Penalty,
    Reconstruction,
)
from torchbrdf.lasting import LastFew
from torchbrdf.light import LightProbe
from torchbrdf.photograph import Observation
from torchbrdf.rendering import render_basis
from torchbrdf.report import Subject, held_by_library
from torchbrdf.transport import BasisImages
from torchbrdf.view import SphereView, View

Wanted = Constraint | Literal["none"]
"""A constraint, or none whatever the penalty."""

_VIEWS = 4
"""Whose estimators are kept for the next photographs."""


@dataclass(frozen=True, eq=False)
class Setting:
    """A light and a view, and the estimator for them: what photographs share."""

    probe: LightProbe
    view: View
    basis: BasisImages
    estimator: BRDFEstimator
    library: MaterialLibrary

    @cached_property
    def observability(self) -> Observability:
        """What the light and the view can tell."""
        return self.estimator.observability(self.library)


@dataclass(frozen=True, eq=False)
class Fit:
    """An observation and what came of it.

    combined  the table where it was made without those of the classes
    """

    subject: Subject
    setting: Setting
    combined: MerlTable | None = None

    @property
    def result(self) -> Reconstruction:
        """The weights."""
        return self.subject.result

    @property
    def estimator(self) -> BRDFEstimator:
        """Which found them."""
        return self.setting.estimator

    @property
    def classes(self) -> MaterialClasses:
        """Of the library."""
        return self.estimator.classes

    @property
    def table(self) -> MerlTable:
        """What they weigh, as one table."""
        return self.combined or self.subject.tables[0]

    @property
    def image(self) -> Tensor:
        """(3, H, W): the photograph as the weights explain it."""
        image = self.result.image
        return image[0] if isinstance(image, tuple) else image


class Estimates:
    """How photographs are explained: by one library, with one penalty; estimators of the last few views are kept."""

    def __init__(
        self,
        library: MaterialLibrary,
        penalty: Penalty = DEFAULT_PENALTY,
        constraint: Wanted | None = None,
        robust: bool = False,
    ) -> None:
        """As `BRDFEstimator` takes them.

        constraint  None: "lobes" of the average over priors, which shows highlights no worse and leaves no holes in
                    them (docs/constraints.md); none with a fixed penalty, the paper's method
        """
        self.library, self.classes = library, MaterialClasses.fit(library)
        self._penalty: Penalty = penalty
        asked = constraint or ("lobes" if penalty == "auto" else "none")
        self._constraint: Constraint | None = None if asked == "none" else asked
        self._robust = robust
        self._bases: LastFew[tuple[str, str], BasisImages] = LastFew(_VIEWS)
        self._settings: LastFew[tuple[str, str], Setting] = LastFew(_VIEWS)

    def basis(self, probe: LightProbe, view: View) -> BasisImages:
        """The images of a view under a light."""
        key = probe.fingerprint, view.fingerprint
        return self._bases.get_or_make(key, lambda: render_basis(self.library, probe, view, progress=True))

    def setting(self, probe: LightProbe, view: View, basis: BasisImages | None = None) -> Setting:
        """That of a light and a view.

        basis  rendered before, with this library, probe and view
        """

        def made() -> Setting:
            images = basis or self.basis(probe, view)
            return Setting(probe, view, images, self.estimator(images), self.library)

        return self._settings.get_or_make((probe.fingerprint, view.fingerprint), made)

    def estimator(self, basis: BasisImages | Sequence[BasisImages]) -> BRDFEstimator:
        """One for basis images of this library."""
        return BRDFEstimator(
            basis,
            self.classes,
            self._penalty,
            constraint=self._constraint,
            library=self.library,
            robust=self._robust,
        )

    def fits(self, observations: Sequence[Observation], setting: Setting) -> list[Fit]:
        """Explain photographs of as many materials."""
        results = setting.estimator(
            torch.stack([one.image for one in observations]), torch.stack([one.mask for one in observations])
        )
        return [fit_of(one, results[i], setting) for i, one in enumerate(observations)]

    def combined(self, fits: Sequence[Fit]) -> list[Fit]:
        """The same with their tables, made in one pass over the library, which does not stay in memory for it."""
        weights = torch.stack([one.result.weights for one in fits])
        tables = self.library.combine_each(weights, ["reconstruction"] * len(fits), keep=False)
        return [replace(one, combined=table) for one, table in zip(fits, tables, strict=True)]


def fit_of(observation: Observation, result: Reconstruction, setting: Setting) -> Fit:
    """A single result with what it was made from."""
    parts = setting.basis, setting.library, setting.probe, setting.view
    return Fit(Subject(observation.image, observation.mask, result, *parts), setting)


def fit(
    observation: Observation,
    probe: LightProbe,
    library: MaterialLibrary,
    penalty: Penalty = DEFAULT_PENALTY,
    view: View | None = None,
    basis: BasisImages | None = None,
    constraint: Wanted | None = None,
    robust: bool = False,
) -> Fit:
    """Render the basis and solve.

    penalty, constraint, robust  as `Estimates` takes them
    view   default: an orthographic sphere
    basis  rendered before, with this library, probe and view
    """
    view = view or SphereView(observation.image.shape[-1])
    estimates = Estimates(library, penalty, constraint, robust)
    return estimates.fits([observation], estimates.setting(probe, view, basis))[0]


def result_record(record: Mapping[str, Any]) -> dict[str, Any]:
    """What a script is told of a result, from its `weights_record`."""
    return {
        "relative_error": record["relative_error"],
        "class": record["class"],
        "class_probability": record["class_probabilities"][record["class"]],
        "class_probabilities": record["class_probabilities"],
        "normal_coverage": record["normal_coverage"],
    }


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


def relative_std(fitted: Fit) -> float | None:
    """The standard deviation of the photograph as explained, a share of it; None where a result has no posterior.

    It takes 0.15 s: it is for those who ask.
    """
    if fitted.result.posteriors is None:
        return None
    deviation = fitted.result.image_std(fitted.subject.basis)
    return float(deviation.norm() / fitted.image.norm())


def notes(fitted: Fit) -> list[str]:
    """What to know of a result that is no reason to doubt it."""
    of = fitted.subject
    name = held_by_library(of.photograph, of.mask, of.basis)
    return [] if name is None else [f"the library holds {name}, which looks the same; to test on it: --without {name}"]


def summary(fitted: Fit) -> str:
    """One line on what was found."""
    result = fitted.result
    j = int(result.class_index)
    if result.posteriors is None:
        what = f"class {j}"
    else:
        what = f"most probably of class {j} ({float(result.class_probabilities[j]):.0%})"
    if (last := fitted.classes.n_classes - 1):
        what += f", from 0, the dullest, to {last}, mirror-like"
    return f"{what}; relative error on the photograph {float(result.relative_error):.2%}"
