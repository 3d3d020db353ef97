"""How close estimates come to targets under light that they were not made under."""

import ast
import inspect
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

from torchbrdf.brdf import MaterialLibrary
from torchbrdf.estimation import DEFAULT_PENALTY, BRDFEstimator, MaterialClasses
from torchbrdf.experiments.accuracy_cases import FLOOR, Case
from torchbrdf.experiments.families import RELATIONS, Relation, by_relatives, relatives
from torchbrdf.experiments.scenes import Scene, noisy_observations
from torchbrdf.experiments.targets import Target
from torchbrdf.images import relative_rms
from torchbrdf.light import LightProbe
from torchbrdf.rendering import render_basis, render_tables
from torchbrdf.transport import BasisImages
from torchbrdf.view import SphereView

_CLASSES_TAKE = tuple(inspect.signature(MaterialClasses.fit).parameters)[1:]


_ESTIMATOR_TAKES = tuple(inspect.signature(BRDFEstimator.__init__).parameters)[3:]


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

    library: MaterialLibrary
    view: SphereView
    probes: Mapping[str, LightProbe]
    targets: Mapping[str, Mapping[str, Target]]
    bases: Mapping[str, BasisImages]
    tables: bool = False

    @classmethod
    def of(
        cls,
        library: MaterialLibrary,
        probes: Mapping[str, LightProbe],
        targets: Sequence[Target],
        tables: bool = False,
    ) -> "Experiment":
        """Render the basis images, by samples, whatever is precomputed: errors must not depend on what the cache holds.

        Raises ValueError where a probe or a target is missing.
        """
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
        view = SphereView(targets[0].size)
        used = {name: probe for name, probe in probes.items() if name in found}
        bases = {
            name: render_basis(library, probe, view, backend="sampled")
            for name, probe in tqdm(used.items(), desc="basis", leave=False)
        }
        ordered = {name: {material: found[name][material] for material in materials} for name in used}
        return cls(library, view, used, ordered, bases, tables)

    @property
    def materials(self) -> list[str]:
        """In the order of all stacks."""
        return list(next(iter(self.targets.values())))

    def folds(self, relation: Relation) -> list["Experiment"]:
        """Experiments of those targets that have the same relatives in the library, which does not hold these."""
        found = []
        for dropped, materials in by_relatives(self.materials, self.library.names, relation).items():
            targets = {name: {one: some[one] for one in materials} for name, some in self.targets.items()}
            bases = {name: basis.without(*dropped) for name, basis in self.bases.items()}
            found.append(replace(self, library=self.library.without(*dropped), targets=targets, bases=bases))
        return found

    @property
    def relations(self) -> tuple[Relation, ...]:
        """The kinds of leaving out that make a difference, the family first: what is to be told of each error."""
        by_family, by_material = (by_relatives(self.materials, self.library.names, relation) for relation in RELATIONS)
        return RELATIONS if by_family != by_material else RELATIONS[:1]

    def left_out(self, relation: Relation) -> str:
        """For the title of what the folds have."""
        known = any(by_relatives(self.materials, self.library.names, relation))
        return f"each without its {relation}" if known else "of no family that the library holds"

    def _check_unknown(self) -> None:
        for material in self.materials:
            known = relatives(material, self.library.names, "material")
            if known:
                raise ValueError(f"{known[0]} is in the library that it is to be recovered from; take `folds` first")

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
        return {name: self.bases[name].render(weights.double()) for name in names}

    def error(self, rendered: Tensor, material: str, probe: str) -> float:
        """Of a rendering (3, H, W) under a probe."""
        target = self.targets[probe][material].photograph
        return relative_rms(rendered.double(), target.double(), self.view.mask)

    def cases(
        self, settings: Sequence[Setting], levels: Sequence[float], observed: Sequence[str] | None = None
    ) -> Iterator[Case]:
        """Every material, probe of observation (of `observed`; default: all) and other probe.

        Raises ValueError where the library holds one of the materials.
        """
        self._check_unknown()
        classes: dict[str, MaterialClasses] = {}
        jobs = list(itertools.product(settings, observed or self.probes))
        for setting, probe in tqdm(jobs, desc="fits", leave=False):
            key = repr(setting.classes)
            if key not in classes:
                classes[key] = MaterialClasses.fit(self.library, **setting.classes)
            estimator = BRDFEstimator(self.bases[probe], classes[key], library=self.library, **setting.estimator)
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
        """Least squares on all probes at once, each divided by the norm of its target; errors under every probe.

        Raises ValueError where the library holds one of the materials.
        """
        self._check_unknown()
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
