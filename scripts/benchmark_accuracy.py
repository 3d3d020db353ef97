#!/usr/bin/env python3
"""Claim: under new light the default estimator is closer to unseen materials than least squares and the paper's.

    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmark_accuracy.py --targets targets --library merl --noise 0 1

For every material and probe: fit the target under this probe, render the result under each of the other probes.
error = |rendered - target| / |target| over the channels of the pixels under the mask, in per cent. Channels below
zero, colours outside the gamut of RGB, are set to 0 in the targets, as in any photograph. Always beside the settings
asked for: naive least squares (all columns in one class, no penalty), one class with lambda 0.5 and 0.005, the paper's
four classes with lambda 0.5, the default estimator; and the floor: least squares on all probes at once, each with the
same weight, which is the best that any combination of the library's columns can do on average.

Pixel noise of s %: each pixel and channel times 1 + s e / 100, e standard normal. The targets' own Monte Carlo noise n
adds to the error e of a perfect result, too: the column "less noise" is the mean of sqrt(e^2 - n^2).
With --tables the table that a user would save, whose cells below zero are clamped, is rendered instead of Y w (slow).
With --merl-targets the targets are MERL tables, rendered by torchbrdf with other random numbers than the basis.
"""

import argparse
import ast
import inspect
import itertools
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from accuracy_report import FLOOR, Case, breakdown, percent, summary
from leave_one_out_report import write_rows
from leave_one_out_scenes import Scene, noisy_observations
from targets import Target, default_probes, exposure, on_white, open_probes, read_targets, write_sheet
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.estimator import DEFAULT_PENALTY
from torchbrdf.merl_directory import table_paths
from torchbrdf.metrics import relative_rms
from torchbrdf.rendering import render_tables
from torchbrdf.transport import DEFAULT_SAMPLES

SIZE = 64
"""Pixels along a side of the targets of --merl-targets."""

_CLASSES_TAKE = tuple(inspect.signature(tb.MaterialClasses.fit).parameters)[1:]
_ESTIMATOR_TAKES = tuple(inspect.signature(tb.BRDFEstimator.__init__).parameters)[3:]


@dataclass(frozen=True)
class Setting:
    """Arguments of MaterialClasses.fit and BRDFEstimator, and what the tables call them."""

    name: str
    arguments: Mapping[str, Any]

    @property
    def classes(self) -> dict[str, Any]:
        """Those of MaterialClasses.fit."""
        return {key: value for key, value in self.arguments.items() if key in _CLASSES_TAKE}

    @property
    def estimator(self) -> dict[str, Any]:
        """Those of BRDFEstimator."""
        return {key: value for key, value in self.arguments.items() if key in _ESTIMATOR_TAKES}


BASELINES = (
    Setting("naive", {"n_classes": 1, "penalty": 0.0}),
    Setting("one class 0.5", {"n_classes": 1, "penalty": 0.5}),
    Setting("one class 0.005", {"n_classes": 1, "penalty": 0.005}),
    Setting("paper", {"penalty": "paper"}),
    Setting(f"default ({DEFAULT_PENALTY})", {}),
)

FIGURE_SHOWS = tuple(setting for setting in BASELINES if setting.name != "one class 0.5")


def settings_of(choices: Mapping[str, Sequence[Any]]) -> list[Setting]:
    """All combinations of choices, argument -> values. Raises ValueError for an argument that nothing takes."""
    for key in choices:
        if key not in _CLASSES_TAKE + _ESTIMATOR_TAKES:
            known = ", ".join(_CLASSES_TAKE + _ESTIMATOR_TAKES)
            raise ValueError(f"no setting {key!r}; MaterialClasses.fit and BRDFEstimator take {known}")
    combinations = itertools.product(*choices.values()) if choices else ()
    found = []
    for values in combinations:
        arguments = dict(zip(choices, values, strict=True))
        found.append(Setting(" ".join(f"{key}={value}" for key, value in arguments.items()), arguments))
    return found


def parse_choice(text: str) -> tuple[str, list[Any]]:
    """`KEY=VALUE,VALUE`: numbers where they read as such, else text."""
    key, equals, values = text.partition("=")
    if not equals or not values:
        raise ValueError(f"a setting must be KEY=VALUE or KEY=VALUE,VALUE, got {text!r}")
    return key, [parse_value(value) for value in values.split(",")]


def parse_value(text: str) -> Any:
    """A number, True, False or None where it reads as such, else the text itself."""
    try:
        return ast.literal_eval(text)
    except (SyntaxError, ValueError):
        return text


@dataclass(frozen=True)
class Experiment:
    """Targets of some materials under some probes, and the basis images under these.

    targets  probe -> material -> target; the same materials under every probe
    probes   those with targets, bases their basis images
    tables   render whole tables instead of Y w
    """

    library: tb.MaterialLibrary
    view: tb.SphereView
    probes: Mapping[str, tb.LightProbe]
    targets: Mapping[str, Mapping[str, Target]]
    bases: Mapping[str, tb.BasisImages]
    tables: bool = False

    @classmethod
    def of(
        cls,
        library: tb.MaterialLibrary,
        probes: Mapping[str, tb.LightProbe],
        targets: Sequence[Target],
        tables: bool = False,
    ) -> "Experiment":
        """Render the basis images. Raises ValueError where a probe or a target is missing."""
        by_light = {probe.fingerprint: name for name, probe in probes.items()}
        found: dict[str, dict[str, Target]] = {}
        for target in targets:
            if target.probe_fingerprint not in by_light:
                raise ValueError(f"there are targets under {target.probe}, none of the probes; add it to --probes")
            found.setdefault(by_light[target.probe_fingerprint], {})[target.material] = target
        materials = sorted({target.material for target in targets})
        for name, some in found.items():
            missing = [material for material in materials if material not in some]
            if missing:
                raise ValueError(f"no target of {missing[0]} under {name}; make it with scripts/make_targets.py")
        if len(found) < 2:
            raise ValueError(f"new light needs targets under at least two probes, got {', '.join(found)}")
        view = tb.SphereView(targets[0].size)
        used = {name: probe for name, probe in probes.items() if name in found}
        bases = {name: tb.render_basis(library, used[name], view) for name in tqdm(used, desc="basis", leave=False)}
        ordered = {name: {material: found[name][material] for material in materials} for name in used}
        return cls(library, view, used, ordered, bases, tables)

    @property
    def materials(self) -> list[str]:
        """In the order of all stacks."""
        return list(next(iter(self.targets.values())))

    def observations(self, probe: str, levels: Sequence[float]) -> Tensor:
        """(levels, materials, 3, H, W): photographs under a probe with pixel noise."""
        stacks = [
            noisy_observations(self.view.pack(target.photograph).double(), levels, f"{material} {probe}")
            for material, target in self.targets[probe].items()
        ]
        return self.view.unpack(torch.stack(stacks, dim=1))

    def relit(self, weights: Tensor, names: Sequence[str]) -> dict[str, Tensor]:
        """Renderings (b, 3, H, W) under some probes of results with weights (b, n, 3)."""
        if self.tables:
            tables = [self.library.combine(one) for one in weights]
            return {name: render_tables(tables, self.probes[name], self.view, seed=3000) for name in names}
        rendered = {}
        for name in names:
            packed = torch.einsum("bnc,ncp->bcp", weights.double(), self.bases[name].packed.double())
            rendered[name] = self.view.unpack(packed)
        return rendered

    def error(self, rendered: Tensor, material: str, probe: str) -> float:
        """Of a rendering (3, H, W) under a probe."""
        target = self.targets[probe][material].photograph
        return relative_rms(rendered.double(), target.double(), self.view.mask)

    def cases(
        self, settings: Sequence[Setting], levels: Sequence[float], observed: Sequence[str] | None = None
    ) -> Iterator[Case]:
        """Every material, probe of observation (of `observed`; default: all) and other probe."""
        classes: dict[str, tb.MaterialClasses] = {}
        jobs = list(itertools.product(settings, observed or self.probes))
        for setting, probe in tqdm(jobs, desc="fits", leave=False):
            key = repr(setting.classes)
            if key not in classes:
                classes[key] = tb.MaterialClasses.fit(self.library, **setting.classes)
            estimator = tb.BRDFEstimator(self.bases[probe], classes[key], library=self.library, **setting.estimator)
            others = [name for name in self.probes if name != probe]
            for level, photographs in zip(levels, self.observations(probe, levels), strict=True):
                result = estimator(photographs)
                rendered = self.relit(result.weights, others)
                for (i, material), novel in itertools.product(enumerate(self.materials), others):
                    yield Case(
                        setting=setting.name,
                        noise=level,
                        material=material,
                        observed=probe,
                        novel=novel,
                        observation_error=float(result.relative_error[i]),
                        novel_error=self.error(rendered[novel][i], material, novel),
                        own_noise=self.targets[novel][material].noise,
                    )

    def floor(self) -> list[Case]:
        """Least squares on all probes at once, each divided by the norm of its target; errors under every probe."""
        scenes = [Scene.of(name, self.bases[name].packed) for name in self.probes]
        weights = []
        for material in self.materials:
            systems, sides = [], []
            for scene in scenes:
                y = self.view.pack(self.targets[scene.name][material].photograph).double()
                systems.append(scene.r / y.norm())
                sides.append(scene.project(y).coordinates / y.norm())
            system, side = torch.cat(systems, 1), torch.cat(sides, 1)[..., None]
            weights.append(torch.linalg.lstsq(system, side, driver="gelsd").solution[..., 0].T)
        rendered = self.relit(torch.stack(weights), list(self.probes))
        found = []
        for (i, material), name in itertools.product(enumerate(self.materials), self.probes):
            error = self.error(rendered[name][i], material, name)
            own_noise = self.targets[name][material].noise
            found.append(Case(FLOOR, 0, material, name, name, error, error, own_noise))
        return found


def merl_targets(folder: Path, probes: Mapping[str, tb.LightProbe], size: int) -> list[Target]:
    """MERL tables as targets, rendered by torchbrdf with four times the samples of basis images; noise not known: 0."""
    view, targets = tb.SphereView(size), []
    for i, path in enumerate(tqdm(table_paths(folder), desc="targets", leave=False)):
        table = tb.MerlTable.open(path)
        for j, (name, probe) in enumerate(probes.items()):
            image = tb.render(table, probe, view, 4 * DEFAULT_SAMPLES, seed=1000 * (j + 1) + i)
            targets.append(Target(path.stem, name, probe.fingerprint, image, 0.0, {}))
    return targets


def figure(path: Path, experiment: Experiment, observed: str, novel: str, materials: Sequence[str]) -> None:
    """A picture: photographs, the truth under the novel probe, and there what the baselines make of the photographs."""
    for name in (observed, novel):
        if name not in experiment.probes:
            raise ValueError(f"--figure: there are targets under {', '.join(experiment.probes)}, not under {name}")
    for material in materials:
        if material not in experiment.materials:
            raise ValueError(f"--figure-materials: there are {', '.join(experiment.materials)}, not {material}")
    photographs = experiment.observations(observed, [0])[0]
    rendered = []
    for setting in FIGURE_SHOWS:
        classes = tb.MaterialClasses.fit(experiment.library, **setting.classes)
        result = tb.BRDFEstimator(experiment.bases[observed], classes, **setting.estimator)(photographs)
        rendered.append(experiment.relit(result.weights, [novel])[novel])
    rows = {}
    for material in materials or experiment.materials:
        i = experiment.materials.index(material)
        truth = experiment.targets[novel][material].photograph
        shown = [(photographs[i], exposure([photographs[i]]))]
        shown += [(image, exposure([truth])) for image in (truth, *(some[i] for some in rendered))]
        rows[material.removesuffix("_rgb")] = [on_white(image, experiment.view.mask, scale) for image, scale in shown]
    titles = [
        f"photograph,\n{observed}",
        f"truth,\n{novel}",
        *(f"{setting.name},\n{novel}" for setting in FIGURE_SHOWS),
    ]
    write_sheet(path, rows, titles, tile=88)


def run(options: argparse.Namespace) -> None:
    choices = {"n_classes": options.n_classes, "penalty": [parse_value(value) for value in options.penalty]}
    choices = {key: values for key, values in choices.items() if values} | dict(map(parse_choice, options.setting))
    settings = [*BASELINES, *settings_of(choices)]
    if options.merl_targets is None and not options.targets.is_dir():
        raise FileNotFoundError(
            f"{options.targets}: no such folder of targets; make it with scripts/make_targets.py "
            f"--measured ../shared/data/rgl -o {options.targets}"
        )
    probes = open_probes(options.probes or default_probes())
    unknown = [name for name in options.observe or () if name not in probes]
    if unknown:
        raise ValueError(f"--observe {unknown[0]}: there are the probes {', '.join(probes)}")
    library = tb.MaterialLibrary.default() if options.library is None else tb.MaterialLibrary.from_merl(options.library)
    folder = options.merl_targets
    targets = read_targets(options.targets) if folder is None else merl_targets(folder, probes, SIZE)
    experiment = Experiment.of(library, probes, targets, options.tables)
    if options.figure:
        path, observed, novel = options.figure
        figure(Path(path), experiment, observed, novel, options.figure_materials)

    floor = experiment.floor()
    cases = list(experiment.cases(settings, options.noise, options.observe))
    if options.csv:
        write_rows(options.csv, [asdict(case) for case in [*cases, *floor]])
    print(
        f"{len(experiment.materials)} materials, {len(experiment.probes)} probes, {experiment.view.size[0]} x "
        f"{experiment.view.size[1]} pixels, library of {len(library)}; "
        f"{'whole tables' if options.tables else 'Y w'}; errors in per cent"
    )
    own = [target.noise for target in targets]
    if any(own):
        negative = max(targets, key=lambda target: target.negative)
        print(
            f"targets' own noise: mean {percent(statistics.mean(own))}, largest {percent(max(own))}; colours below "
            f"zero: at most {percent(negative.negative)} of the norm ({negative.material}, {negative.probe}), set to 0"
        )
    for level in options.noise:
        some = [case for case in cases if case.noise == level] + floor
        print(f"\n{level:g} % pixel noise\n\n{summary(some)}")
        for by in ("material", "observed", "novel"):
            print(f"\n{level:g} % pixel noise, observation / novel light by {by}\n\n{breakdown(some, by)}")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--targets", type=Path, default=Path("targets"), help="folder that make_targets.py wrote")
    parser.add_argument("--merl-targets", type=Path, metavar="FOLDER", help="instead: *.binary tables to recover")
    parser.add_argument("--library", type=Path, help="folder of MERL *.binary tables; default: the embedded library")
    parser.add_argument("--probes", nargs="+", type=Path, metavar="FILE", help="default: 7 of ../shared/data/probes")
    parser.add_argument("--observe", nargs="+", metavar="NAME", help="photographs only under these; default: under all")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0], help="in %% of every pixel")
    parser.add_argument("--penalty", nargs="+", default=[], help="of BRDFEstimator, several values")
    parser.add_argument("--n-classes", nargs="+", type=int, default=[], help="of MaterialClasses.fit, several values")
    parser.add_argument(
        "--setting", nargs="+", default=[], metavar="KEY=VALUE,...", help="values of any other argument of these two"
    )
    parser.add_argument("--tables", action="store_true", help="render whole tables instead of Y w")
    parser.add_argument("--csv", type=Path, help="write every case")
    parser.add_argument(
        "--figure", nargs=3, metavar=("PNG", "OBSERVED", "NOVEL"), help="draw results under a new probe"
    )
    parser.add_argument("--figure-materials", nargs="+", default=[], metavar="NAME", help="of these; default: of all")
    options = parser.parse_args(argv)
    return exit_status("benchmark_accuracy", run, options)


if __name__ == "__main__":
    sys.exit(main())
