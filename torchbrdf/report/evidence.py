"""What a report shows, before it becomes a page: result and candidates, renderings, spreads, and the warnings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import cos, pi, radians, sin
from typing import Any

import torch
from torch import Tensor

from torchbrdf.brdf import MaterialLibrary, MerlTable, directional_albedo
from torchbrdf.estimation import Reconstruction
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, relative_rms
from torchbrdf.light import LightProbe
from torchbrdf.rendering import directional_pictures, render_tables
from torchbrdf.report._deviations import Spread, gather_spread
from torchbrdf.report.doubts import Doubt, clamped_share, darkest_middle, doubts, margin, oscillation_of, second_best
from torchbrdf.report.grade import Grade, grade_of
from torchbrdf.threads import side_by_side
from torchbrdf.transport import BasisImages
from torchbrdf.transport.harmonic import SHOWN, HarmonicBasis, is_precomputed, table_pictures
from torchbrdf.view import SphereView, View

DIRECTIONAL_ANGLES = (0.0, 136.0)
"""The two directional lights of [CBP21, fig. 2], in degrees about +Y from the camera."""

TURN_DEG = 120.0
"""How far the photograph's own probe is turned about +Y."""

_TURNED_HEIGHT = 128
"""Rows of the turned probe, which is only shown."""

_CANDIDATE_SIZE = 96
"""Pixels along a side of the spheres of candidates, at most: they are shown small."""


@dataclass(frozen=True, eq=False)
class Subject:
    """What a report is about: a reconstruction and what it was made from.

    photograph   (3, H, W)  linear radiance, as given to the estimator
    mask         (1, H, W)  bool, the pixels that were used
    result       the reconstruction, a single one
    basis, library, probe, view  what it was made with
    Raises ValueError where these do not belong together.
    """

    photograph: Tensor
    mask: Tensor
    result: Reconstruction
    basis: BasisImages
    library: MaterialLibrary
    probe: LightProbe
    view: View

    def __post_init__(self) -> None:
        """Check that the parts belong together."""
        photograph, mask, result = self.photograph, self.mask, self.result
        basis, library = self.basis, self.library
        result.check_library(library, "a report")
        if photograph.shape != (shape := (3, *basis.size)):
            raise ValueError(f"photograph must be {shape} like the basis images, got {tuple(photograph.shape)}")
        if mask.shape != (shape := (1, *basis.size)) or mask.dtype != torch.bool:
            raise ValueError(f"mask must be bool {shape}, got {mask.dtype} {tuple(mask.shape)}")
        if (basis.library, basis.names) != (result.library, result.names):
            raise ValueError("the basis images are not those of this reconstruction: another library")
        if basis.probe != self.probe.fingerprint:
            raise ValueError("the basis images were rendered with another light probe")
        if basis.view != self.view.fingerprint:
            raise ValueError("the basis images were rendered with another view")

    @cached_property
    def tables(self) -> list[MerlTable]:
        """The result, and then the candidate of every class."""
        return self.result.tables(self.library, keep=False)


@dataclass(frozen=True, eq=False)
class Candidate:
    """What one class makes of the photograph, or the result itself.

    index     the class; None for a result that is none of the classes' candidates
    probability  of the class; None for such a result, and with a fixed penalty, which has no probabilities
    members   basis BRDFs with a weight
    leading   the materials of largest weight, most important first
    error     |Y w - y| / |y| over the pixels used
    fitted    (3, H, W)  Y w
    table     the BRDF
    clamped   share of measured values at zero, where B w <= 0
    novel     (3, N, N)  under another light, see `other_light`; smaller where it is not the result, and without the
              cut at zero of the table's values
    frontal   (3, N, N)  under a directional light from the camera
    """

    index: int | None
    probability: float | None
    members: int
    leading: tuple[str, ...]
    error: float
    fitted: Tensor
    table: MerlTable
    clamped: float
    novel: Tensor
    frontal: Tensor


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything that the report of one reconstruction shows.

    used         (1, H, W) bool  pixels of the photograph that count
    found        the result: the average over the priors, or with a fixed penalty the candidate of the best class
    candidates   one a class, in order; chosen is the index of the best
    weights      (n, 3) float64  of the result
    names        the materials behind them
    channel_errors  |Y w - y| / |y| for R, G, B of the result; NaN where a channel is black
    turned       (3, N, N)  the result under the photograph's probe turned by TURN_DEG
    directional  angle -> (3, M, M)  the result under directional lights, irradiance pi
    probes       the photograph's probe, another (`other_light`), its own turned, of few rows
    distrust     why the shape tells too little (`BasisImages.distrust`), or None
    spread       None with a fixed penalty, which has no posterior
    albedo       (4, 3)  the result's `directional_albedo`
    known        what is doubtful of the capture whatever came out
    middle       of highlights, see `darkest_middle`
    same_room    whether the other light is the photograph's own, turned
    """

    photograph: Tensor
    used: Tensor
    found: Candidate
    candidates: tuple[Candidate, ...]
    chosen: int
    weights: Tensor
    names: tuple[str, ...]
    channel_errors: tuple[float, ...]
    turned: Tensor
    directional: dict[float, Tensor]
    probes: tuple[LightProbe, LightProbe, LightProbe]
    albedo: Tensor
    distrust: str | None = None
    spread: Spread | None = None
    known: tuple[Doubt, ...] = ()
    middle: float = 1.0
    same_room: bool = False

    @property
    def averaged(self) -> bool:
        """Whether the result is an average over classes and other priors, and not one class's candidate."""
        return self.found.index is None

    @property
    def best(self) -> Candidate:
        """The candidate of the best class: the most probable; with a fixed penalty that of smallest error."""
        return self.candidates[self.chosen]

    @cached_property
    def runner_up(self) -> Candidate | None:
        """The second best class; None where there is only one."""
        return second_best(self.candidates, self.chosen)

    @property
    def margin(self) -> float:
        """The runner-up's error over that of the best; infinite without a runner-up or without a residual."""
        return margin(self.best, self.runner_up)

    @property
    def doubts(self) -> list[Doubt]:
        """The reasons to doubt the result."""
        return [*self.known, *self.found_doubts]

    @cached_property
    def found_doubts(self) -> list[Doubt]:
        """Those that are not of the capture."""
        return doubts(
            error=self.found.error,
            classes=self.candidates,
            chosen=self.chosen,
            albedo=self.albedo.mean(1),
            oscillation=oscillation_of(self.weights),
            clamped=self.found.clamped,
            middle=self.middle,
            distrust=self.distrust,
            spread=self.typical_spread,
        )

    @property
    def typical_spread(self) -> float | None:
        """Relative standard deviation of the picture under another light; None where that is not known."""
        return None if self.spread is None else self.spread.typical

    @property
    def other_room(self) -> str:
        """Which light `other_light` is, in words."""
        return "the same room, turned by 180°" if self.same_room else "torchbrdf’s studio room"

    @property
    def grade(self) -> Grade:
        """Whether the result is good."""
        return grade_of(self.found.error, self.typical_spread, [doubt.topic for doubt in self.doubts])


def gather(
    subject: Subject,
    size: int,
    samples: int,
    known: Sequence[Doubt] = (),
    primaries: ColourSpace = DEFAULT_SPACE,
) -> Evidence:
    """Tables and renderings of the result and of all candidates, on the CPU.

    size     pixels along a side of the spheres under light that was not observed
    samples  a pixel, for candidates where the library's harmonic transport was not precomputed
    known    what is doubtful of the capture
    primaries  the linear RGB of photograph and light, in which the other light is, too
    """
    result, basis, library, probe = subject.result, subject.basis, subject.library, subject.probe.to("cpu")
    used = subject.mask.cpu() & basis.mask.cpu()
    y = subject.photograph.detach().cpu()
    chosen = int(result.class_index)
    averaged = result.posteriors is not None or not torch.equal(result.weights, result.class_weights[chosen])
    sphere = SphereView(size)
    other = other_light(probe, primaries)
    turn = turn_about_y(TURN_DEG)
    turned = probe.resized(min(probe.height, _TURNED_HEIGHT)).rotated(turn)

    k = len(result.class_weights)
    mean, *tables = subject.tables
    weights = list(result.class_weights.detach().cpu().double())
    squared = list(result.class_errors.detach().cpu())
    if averaged:
        tables, weights = [*tables, mean], [*weights, result.weights.detach().cpu().double()]
        squared = [*squared, result.error.detach().cpu()]
    shown = k if averaged else chosen
    fits = basis.render(torch.stack(weights).to(basis.packed)).cpu()
    small = SphereView(min(size, _CANDIDATE_SIZE))
    final = tables[shown]
    if is_precomputed(library):
        candidates = partial(HarmonicBasis(library, other, small).images_of, torch.stack(weights))
    else:
        candidates = partial(render_tables, tables, other, small, samples)

    def left_open() -> Spread | None:
        return None if result.posteriors is None else gather_spread(result, fits[shown], basis, library, other, size)

    from_camera, behind = (partial(directional_pictures, angle_deg=a, irradiance=pi) for a in DIRECTIONAL_ANGLES)
    parts: list[Callable[[], Any]] = [
        partial(table_pictures, final, [(other, None), (probe, turn)], sphere, SHOWN),
        left_open,
        candidates,
        partial(from_camera, tables, small),
        partial(from_camera, [final], sphere),
        partial(behind, [final], sphere),
        partial(directional_albedo, final),
    ]
    (under_other, under_turned), spread, novel, frontal, (found_frontal,), (from_behind,), albedo = side_by_side(
        lambda make: make(), parts
    )
    made = tuple(
        Candidate(
            index=j if j < k else None,
            probability=None if j == k or result.posteriors is None else float(result.class_probabilities[j]),
            members=int((weights[j] != 0).any(-1).sum()),
            leading=leading_materials(weights[j], result.names, 3),
            error=float((squared[j] / result.energy.detach().cpu()).clamp_min(0).sqrt()),
            fitted=fits[j],
            table=table,
            clamped=clamped_share(table),
            novel=under_other if table is final else novel[j].cpu(),
            frontal=found_frontal if table is final else frontal[j],
        )
        for j, table in enumerate(tables)
    )
    found = made[shown]
    return Evidence(
        photograph=y,
        used=used,
        found=found,
        candidates=made[:k],
        chosen=chosen,
        weights=weights[shown],
        names=result.names,
        channel_errors=tuple(
            relative_rms(found.fitted[c], y[c], used[0]) if y[c][used[0]].any() else float("nan") for c in range(3)
        ),
        turned=under_turned,
        directional=dict(zip(DIRECTIONAL_ANGLES, (found_frontal, from_behind), strict=True)),
        probes=(probe, other, turned),
        albedo=albedo,
        distrust=basis.distrust,
        spread=spread,
        known=tuple(known),
        middle=darkest_middle(found.table),
        same_room=other.fingerprint != LightProbe.default(primaries=primaries).fingerprint,
    )


def other_light(probe: LightProbe, primaries: ColourSpace = DEFAULT_SPACE) -> LightProbe:
    """A probe that is not this one: the default, turned by half where the photograph was taken under it."""
    default = LightProbe.default(primaries=primaries)
    return default.rotated(turn_about_y(180.0)) if default.fingerprint == probe.fingerprint else default


def turn_about_y(angle_deg: float) -> Tensor:
    """(3, 3): the rotation that takes +Z (the camera's side) towards +X (image right)."""
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    return torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]], dtype=torch.float64)


def leading_materials(weights: Tensor, names: Sequence[str], count: int) -> tuple[str, ...]:
    """The materials with the largest |w| (n, 3) over their channels and those of the result."""
    strength = weights.abs().unflatten(0, (-1, 3)).amax((1, 2))
    order = torch.argsort(strength, descending=True, stable=True)[:count]
    return tuple(names[int(i)] for i in order if strength[i] > 0)
