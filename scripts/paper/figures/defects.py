"""Figure 4 of [CBP21]: measured materials that no library holds, from photographs with defects and masks of them.

The paper photographed three balls. Here Mitsuba renders them (`figure_capture`), so that the truth is known.
"""

import hashlib
import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from make_targets import Material, Quality as TargetQuality, render_halves
from paper.figures.capture import Defects, Frame, geometry, lit_ball, painted_mask, photograph_of, recorded
from paper.figures.light import DIRECTIONAL, Light, ball_error, percent
from paper.figures.sheet import Block, Cell, Row, Sheet, Tile, photograph_tile
from paper.figures.studio import NAIVE, OURS, PAPER, Studio, stored
from torchbrdf.experiments import Setting, markdown_table
from torchbrdf.mitsuba_backend import MitsubaScene
from torchbrdf.photograph import Observation, observe

CAPTURED = ("acrylic_felt_pink_rgb", "ilm_solo_m_68_rgb", "cc_ibiza_sunset_rgb")
"""Felt, blue lacquer and a metallic paint, for the orange foam, blue plastic and dark bronze of the paper."""

ALL = Defects(dimple=True, stand=True, noise=2.0, exposure=1.05, degrees=1.0)

ONE_BY_ONE = {
    "none": Defects(),
    "dimple": Defects(dimple=True),
    "stand": Defects(stand=True),
    "noise of 2 %": Defects(noise=ALL.noise),
    "5 % too bright": Defects(exposure=ALL.exposure),
    "probe turned by 1 degree": Defects(degrees=ALL.degrees),
    "all": ALL,
}

SAMPLES, MOST_SAMPLES = 1024, 1 << 15
PHOTOGRAPH_NOISE, REFERENCE_NOISE = 0.02, 0.01
"""Monte Carlo noise above which samples are added. That of a photograph is halved where its pixels are averaged."""


@dataclass(frozen=True)
class Capture:
    """What the user has: photograph (3, N, N), the mask (1, N, N) painted for it, and the probe as it was recorded."""

    frame: Frame
    photograph: Tensor
    mask: Tensor
    probe: tb.LightProbe

    def observed(self, size: int, masked: bool) -> Observation:
        """The photograph on the pixels of SphereView(size), with the mask or as if the whole ball were sound."""
        return observe(self.photograph, self.frame.circle, self.mask if masked else None, size)


def as_recorded(studio: Studio, capture: Capture) -> tb.LightProbe:
    """The probe as the user has it."""
    return capture.probe


@dataclass(frozen=True)
class Column:
    """A way to use a photograph.

    title    over its column
    setting  of the estimator
    masked   whether the mask is used, or the whole ball
    shown    in the figure, or only in the table
    probe    what light the estimator is told, from a capture
    """

    title: str
    setting: Setting
    masked: bool
    shown: bool = True
    probe: Callable[[Studio, Capture], tb.LightProbe] = as_recorded

    def weights(self, studio: Studio, capture: Capture) -> Tensor:
        """(n, 3) over the library."""
        seen = capture.observed(studio.quality.size, self.masked)
        estimator = studio.estimator(studio.library, self.probe(studio, capture), self.setting)
        return estimator(seen.image, seen.mask).weights


_ROBUST = Setting("robust", {**OURS.arguments, "robust": True})

COLUMNS = (
    Column("naive,\nmasked", NAIVE, True),
    Column("paper,\nwhole ball", PAPER, False),
    Column("paper,\nmasked", PAPER, True),
    Column("default,\nwhole ball", OURS, False),
    Column("default,\nmasked", OURS, True),
    Column("robust,\nwhole ball", _ROBUST, False, shown=False),
)
"""All are in the table; another way to use a photograph is one more line here."""


class Subject:
    """One measured material under the light it is photographed in and under another."""

    def __init__(self, studio: Studio, material: Material, capture: tb.LightProbe, novel: tb.LightProbe) -> None:
        """Keep them."""
        self.studio, self.material = studio, material
        self.captured, self.novel = capture, novel
        self.frame = Frame(studio.quality.tile)

    def capture(self, defects: Defects) -> Capture:
        """A photograph with defects."""
        image = self._rendered(replace(Defects(), dimple=defects.dimple, stand=defects.stand))
        if defects.noise:
            image = self.studio.noisy(image, self.material.name, defects.noise)
        mask = painted_mask(self.frame, defects)
        return Capture(self.frame, defects.exposure * image, mask, recorded(self.captured, defects))

    def references(self) -> list[tuple[Light, Tensor]]:
        """The sound ball (3, T, T) under the light of the photograph, under the novel and under a directional one."""
        view, seed, angle = self.studio.shown, self.studio.quality.seed, DIRECTIONAL[0]

        def make() -> dict[str, Tensor]:
            quality = self._quality(REFERENCE_NOISE)
            halves, _ = render_halves(MitsubaScene(view, self.novel, self.material.bsdf), quality, seed)
            lit = lit_ball(self.material.bsdf, view, angle, quality.samples)
            return {"novel": halves.image.clamp_min(0), "directional": lit}

        kept = stored(self._path("reference"), self._facts(probe=self.novel.fingerprint), make)
        clean = view.unpack(view.pack(self.frame.cropped(self._rendered(Defects()))))
        return [
            (Light(self.captured), clean),
            (Light(self.novel), kept["novel"]),
            (Light(angle), kept["directional"]),
        ]

    def _rendered(self, defects: Defects) -> Tensor:
        def make() -> dict[str, Tensor]:
            quality = self._quality(PHOTOGRAPH_NOISE)
            return {"image": photograph_of(self.material.bsdf, self.captured, self.frame, defects, quality)}

        parts = [name for name in ("dimple", "stand") if getattr(defects, name)]
        facts = self._facts(probe=self.captured.fingerprint, defects=asdict(defects), geometry=geometry())
        return stored(self._path("-".join(["capture", *parts])), facts, make)["image"]

    def _quality(self, noise: float) -> TargetQuality:
        studio = self.studio.quality
        samples = SAMPLES if studio.samples is None else studio.samples
        return TargetQuality(studio.tile, samples, noise, max(samples, MOST_SAMPLES), studio.seed)

    def _facts(self, **others: object) -> dict[str, object]:
        quality = self.studio.quality
        facts = {"version": tb.__version__, "tile": quality.tile, "samples": quality.samples, "seed": quality.seed}
        return facts | {"material": self.material.identity, **others}

    def _path(self, what: str) -> Path:
        return self.studio.folder / f"{self.material.name}-{what}.safetensors"


def figure_4(studio: Studio, probes: Sequence[tb.LightProbe], materials: Sequence[Material]) -> tuple[Sheet, str]:
    """[CBP21, fig. 4]: captured under the first probe, shown under it, the third and a directional light."""
    subjects = [Subject(studio, material, probes[0], probes[2]) for material in materials]
    with tqdm(total=5 * len(subjects), desc="figure 4: photographs") as bar:
        for subject in subjects:
            for parts in (Defects(), Defects(dimple=True), Defects(stand=True), ALL):
                subject.capture(parts)
                bar.update()
            subject.references()
            bar.update()
    found: dict[tuple[str, str], Tensor] = {}
    jobs = [(column, name) for column in COLUMNS for name in ONE_BY_ONE]
    for column, name in tqdm(jobs, desc="figure 4: fits"):
        found[column.title, name] = _fits(subjects, column, ONE_BY_ONE[name])
    shown = [column for column in COLUMNS if column.shown]
    blocks = [
        _block(subject, shown, [found[column.title, "all"][i] for column in shown])
        for i, subject in enumerate(tqdm(subjects, desc="figure 4: pictures"))
    ]
    rows = []
    for name in ONE_BY_ONE:
        errors = [_novel_errors(subjects, found[column.title, name]) for column in COLUMNS]
        rows.append([name, *(percent(statistics.mean(some)) for some in errors)])
    return Sheet(blocks), markdown_table(["defect", *(column.title.replace("\n", " ") for column in COLUMNS)], rows)


def _fits(subjects: Sequence[Subject], column: Column, defects: Defects) -> Tensor:
    """(B, n, 3) of all subjects, kept on disk."""
    studio = subjects[0].studio
    facts = studio.facts(
        probe=subjects[0].captured.fingerprint,
        materials=[subject.material.identity for subject in subjects],
        column=[column.title, column.setting.arguments, column.masked],
        defects=asdict(defects),
        geometry=geometry(),
    )
    key = hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:12]

    def make() -> dict[str, Tensor]:
        return {"weights": torch.stack([column.weights(studio, subject.capture(defects)) for subject in subjects])}

    return stored(studio.folder / f"fits-captured-{key}.safetensors", facts, make)["weights"]


def _novel_errors(subjects: Sequence[Subject], weights: Tensor) -> list[float]:
    errors = []
    for subject, one in zip(subjects, weights, strict=True):
        light, reference = subject.references()[1]
        errors.append(ball_error(subject.studio.under([one], light)[0], reference))
    return errors


def _block(subject: Subject, columns: Sequence[Column], weights: Sequence[Tensor]) -> Block:
    """Rows of one material: under the light of the photograph, novel light and a directional one."""
    studio, capture, tile = subject.studio, subject.capture(ALL), subject.studio.quality.tile
    references = subject.references()
    scale = references[0][0].exposure([references[0][1]])
    mask = capture.mask.float().expand_as(capture.photograph)
    given: list[Cell] = [
        Tile(photograph_tile(capture.photograph, tile, scale), "photograph"),
        Tile(photograph_tile(mask, tile), "mask"),
        None,
    ]
    rows = []
    for first, (light, reference) in zip(given, references, strict=True):
        scale = light.exposure([reference])
        images = [reference, *studio.under(weights, light)]
        row = light.row(light.label(scale).replace(", ", ",\n"), images, [reference] * len(images), scale)
        rows.append(Row(row.label, [first, *row.cells]))
    titles = ["given", "reference", *(column.title for column in columns)]
    return Block(subject.material.name.removesuffix("_rgb"), titles, rows)
