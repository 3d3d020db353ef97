#!/usr/bin/env python3
"""Claim: pictures under other light are as far off as the report's grade says, whatever is wrong with the capture.

    python scripts/benchmarks/grades.py -o OUT
    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmarks/grades.py --targets targets -o OUT_MEASURED

Every eighth material of the embedded library, left out with its family and the five materials most like it, is
photographed under each light with 1 % noise, and then with a defect more each time. The report's grade comes from that
photograph alone; the error is |rendered - truth| / |truth| under other light, the mean over the same light from two
other sides and torchbrdf's room from two. The limits of the grades were chosen on the even ones of these materials.
With --targets the materials are measured ones, each without its family, the other lights are the other probes, and the
light is not turned.

OUT holds one file a light: run the same command again to continue.
"""

import argparse
import json
import statistics
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from calibration import likeness, whole_without
from capture_sensitivity import clipped, noisy
from observability import artificial
from torchbrdf.brdf import above_horizon
from torchbrdf.brdf.albedo import albedo_of
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.experiments import (
    Experiment,
    Target,
    default_probes,
    markdown_table,
    noisy_observations,
    open_probes,
    percent,
    read_targets,
    relatives,
    tilt,
)
from torchbrdf.files import writing
from torchbrdf.light import other_lights
from torchbrdf.report.advice import TOPICS, Topic
from torchbrdf.report.doubts import ClassShare, doubts, oscillation_of
from torchbrdf.report.grade import FAIR_ERROR, GOOD_ERROR, GRADES, Word, grade_of

LIGHTS = ("room", "uffizi", "grace", "ennis", "dawn", "uniform", "gradient", "lamp in front")
TURNS = (2, 5)
STEP, ALIKE, SIZE = 8, 5, 48
CHECKED = 4096
"""Random cells that tell which share of a table is clamped."""

Photographs = dict[str, tuple[Tensor, Tensor]]
"""Defect -> photograph (3, N, N) and mask (1, N, N)."""


@dataclass(frozen=True)
class Row:
    """What a report knows of a photograph, and how far off the result is under each other light."""

    material: str
    light: str
    defect: str
    even: bool
    residual: float
    spread: float
    oscillation: float
    clamped: float
    albedo: float
    probability: float
    errors: list[float]

    @property
    def error(self) -> float:
        """Mean over the lights."""
        return statistics.mean(self.errors)

    @property
    def topics(self) -> list[Topic]:
        """What there would be warnings of."""
        found = doubts(
            error=self.residual,
            classes=[ClassShare(0, self.probability, 0.0), ClassShare(1, 1 - self.probability, 0.0)],
            chosen=0,
            albedo=torch.tensor([self.albedo, 0, 0, 0]),
            oscillation=self.oscillation,
            clamped=self.clamped,
            middle=1.0,  # of no weight for the grade
            distrust=None,
            spread=self.spread,
        )
        return [doubt.topic for doubt in found]

    @property
    def word(self) -> Word:
        """The grade."""
        return grade_of(self.residual, self.spread, self.topics).word


class Judge:
    """What a report says of results, by a library's columns: without tables, which take long."""

    def __init__(self, library: tb.MaterialLibrary) -> None:
        """Read some cells, and the albedos, of all columns."""
        cells = torch.nonzero(above_horizon().ravel()).ravel()
        some = cells[torch.randperm(len(cells), generator=torch.Generator().manual_seed(0))[:CHECKED]]
        self.names = library.names
        self.cells, self.albedo = library.rows(some.sort().values).double(), albedo_of(library.rows)

    def row(self, result: tb.Reconstruction, room: tb.BasisImages, errors: list[float], **labels: Any) -> Row:
        """Of a single result; room  basis images under the light in which the report shows it."""
        columns = [3 * self.names.index(name) + channel for name in result.names for channel in range(3)]
        weights = result.weights.double()
        radiance = room.render(weights)
        return Row(
            **labels,
            residual=float(result.relative_error),
            spread=float(room.pack(result.image_std(room)).double().norm() / radiance.norm()),
            oscillation=oscillation_of(weights),
            clamped=float((self.cells[:, columns] @ weights <= 0).double().mean()),
            albedo=float((self.albedo[:, columns] @ weights).mean(1).max()),
            probability=float(result.class_probabilities.max()),
            errors=errors,
        )


def defects(clean: Tensor, view: tb.SphereView, key: str) -> Photographs:
    """Photographs of a ball, one a defect, from one without noise."""
    photograph = view.unpack(noisy_observations(view.pack(clean).double(), [1.0], key))[0]
    third = view.mask.clone()
    third[..., SIZE // 3 * clean.shape[-1] // SIZE :] = False
    third[..., : 10 * clean.shape[-1] // SIZE, :] = False
    return {
        "none": (photograph, view.mask),
        "noise of 5 %": noisy(0.05)(photograph, view.mask),
        "brightest 2 % clipped": clipped(masked=False)(photograph, view.mask),
        "a third of the ball": (photograph, third),
    }


def solved(estimator: tb.BRDFEstimator, photographs: Photographs) -> Iterator[tuple[str, tb.Reconstruction]]:
    """Each with its name."""
    images, masks = (torch.stack(each) for each in zip(*photographs.values(), strict=True))
    results = estimator(images, masks)
    return ((name, results[i]) for i, name in enumerate(photographs))


def light_of(name: str) -> tb.LightProbe:
    """One of LIGHTS."""
    if name == "room":
        return tb.LightProbe.default()
    paths = [path for path in default_probes() if path.stem == name]
    return open_probes(paths)[name] if paths else artificial()[name]


def left_out(library: tb.MaterialLibrary, light: str, judge: Judge) -> Iterator[Row]:
    """Materials of the library under a light."""
    view, probe, room = tb.SphereView(SIZE), light_of(light), tb.LightProbe.default()

    def rendered(one: tb.LightProbe) -> tb.BasisImages:
        return tb.render_basis(library, one, view)

    basis, classes = rendered(probe), tb.MaterialClasses.fit(library)
    turned = {f"light turned by {degrees} degrees": rendered(probe.rotated(tilt(degrees))) for degrees in TURNS}
    novel = [rendered(one) for one in (*other_lights(probe)[:2], *other_lights(room)[3:5])]
    shown = 1 if light == "room" else 2  # the report's other light: the room, of itself turned by half
    angles = likeness(novel[2])
    for i in tqdm(range(0, len(library), STEP), desc=light, leave=False):
        material = library.names[i]
        alike = [library.names[j] for j in angles[i].argsort()[: ALIKE + 1].tolist()]
        dropped = dict.fromkeys([material, *alike, *relatives(material, library.names)])
        less = library.without(*dropped)
        estimator = tb.BRDFEstimator(basis.without(*dropped), whole_without(classes, less))
        others = [one.without(*dropped) for one in novel]
        photographs = defects(basis.image(material), view, f"{material} {light}")
        for name, one in turned.items():
            photographs[name] = defects(one.image(material), view, f"{material} {light}")["none"]
        for defect, result in solved(estimator, photographs):
            weights = result.weights.double()
            errors = []
            for whole, one in zip(novel, others, strict=True):
                truth, got = whole.image(material).double(), one.render(weights)
                errors.append(float((got - truth).norm() / truth.norm()))
            labels = {"material": material, "light": light, "defect": defect, "even": i // STEP % 2 == 0}
            yield judge.row(result, others[shown], errors, **labels)


def measured(folds: Sequence[Experiment], light: str, judge: Judge) -> Iterator[Row]:
    """Measured materials under a probe."""
    materials = sorted(material for fold in folds for material in fold.materials)
    library = tb.MaterialLibrary.from_files("default")
    room, classes = tb.render_basis(library, tb.LightProbe.default(), folds[0].view), tb.MaterialClasses.fit(library)
    for fold in tqdm(folds, desc=light, leave=False):
        names = fold.library.names
        estimator = tb.BRDFEstimator(fold.bases[light], whole_without(classes, fold.library))
        for material in fold.materials:
            photographs = defects(fold.targets[light][material].photograph, fold.view, f"{material} {light}")
            for defect, result in solved(estimator, photographs):
                shown = fold.relit(result.weights[None], [name for name in fold.probes if name != light])
                errors = [fold.error(images[0], material, name) for name, images in shown.items()]
                even = materials.index(material) % 2 == 0
                labels = {"material": material, "light": light, "defect": defect, "even": even}
                yield judge.row(result, room.subset(names), errors, **labels)


def experiment(library: tb.MaterialLibrary, folder: Path) -> Experiment:
    """The targets of a folder, with basis images as the commands render them."""
    probes = open_probes([path for path in default_probes() if (folder / path.stem).is_dir()])
    found: dict[str, dict[str, Target]] = {name: {} for name in probes}
    for target in read_targets(folder):
        found[target.probe][target.material] = target
    view = tb.SphereView(next(iter(next(iter(found.values())).values())).size)
    bases = {name: tb.render_basis(library, probe, view) for name, probe in probes.items()}
    return Experiment(library, view, probes, found, bases)


def grades_of(rows: Iterable[Row]) -> str:
    """Table: errors of each grade, and how often they are in its range."""
    rows, table = list(rows), []
    for word in GRADES:
        errors = sorted(row.error for row in rows if row.word == word)
        if errors:
            shares = (sum(error <= most for error in errors) / len(errors) for most in (GOOD_ERROR, FAIR_ERROR))
            nine = errors[min(len(errors) - 1, 9 * len(errors) // 10)]
            figures = percent(statistics.median(errors)), percent(nine), percent(errors[-1])
            table.append([word, str(len(errors)), *(f"{share:.0%}" for share in shares), *figures])
    head = f"grade|photographs|at most {GOOD_ERROR:.0%}|at most {FAIR_ERROR:.0%}|median, %|nine of ten below|worst"
    return markdown_table(head.split("|"), table)


def by_defect(rows: Sequence[Row], key: str) -> str:
    """Table: how often each grade is given, and the median error."""
    table = []
    for value in dict.fromkeys(getattr(row, key) for row in rows):
        some = [row for row in rows if getattr(row, key) == value]
        shares = [f"{sum(row.word == word for row in some) / len(some):.0%}" for word in ("Good", "Fair", "Poor")]
        table.append([value, *shares, percent(statistics.median(row.error for row in some))])
    return markdown_table([key, "good", "fair", "poor", "error, median, %"], table)


def by_warning(rows: Sequence[Row]) -> str:
    """Table: how large a part of the standard deviation the error is, with each warning and without."""
    table = []
    for topic in TOPICS:
        parts = [[row.error / row.spread for row in rows if (topic in row.topics) == there] for there in (True, False)]
        if all(parts):
            medians = [f"{statistics.median(part):.2f}" for part in parts]
            table.append([topic, str(len(parts[0])), *medians, f"{max(parts[0]):.2f}"])
    return markdown_table(["warning", "photographs", "error / deviation", "without it", "worst"], table)


def run(options: argparse.Namespace) -> None:
    library = tb.MaterialLibrary.from_files("default")
    options.output.mkdir(parents=True, exist_ok=True)
    folds: list[Experiment] = []
    lights = options.lights or list(LIGHTS)
    if options.targets is not None:
        folds = experiment(library, options.targets).folds("family")
        lights = options.lights or list(folds[0].probes)
    rows: list[Row] = []
    judge = None
    for light in lights:
        path = options.output / f"{light.replace(' ', '_')}.json"
        if not path.exists():
            judge = judge or Judge(library)
            found = list(measured(folds, light, judge) if folds else left_out(library, light, judge))
            with writing(path) as temporary:
                temporary.write_text(json.dumps([asdict(row) for row in found], indent=0))
        rows += [Row(**each) for each in json.loads(path.read_text())]
    for name, some in (("chose the limits" if not folds else "one half", True), ("the others", False)):
        print(f"Materials: {name}\n\n{grades_of(row for row in rows if row.even == some)}\n")
    print(by_defect(rows, "defect"), by_defect(rows, "light"), by_warning(rows), sep="\n\n")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for what is finished")
    parser.add_argument("--targets", type=Path, help="folder that make_targets.py wrote: measured materials")
    parser.add_argument("--lights", nargs="+", metavar="LIGHT", help="default: all; with --targets, all with targets")
    return exit_status("grades", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
