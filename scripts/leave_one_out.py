#!/usr/bin/env python3
"""Leave-one-out experiment [CBP21, sec. VII]: every material of a library, reconstructed without itself.

    python scripts/leave_one_out.py --library MERL_DIR --probes grace.hdr uffizi.hdr default -o OUT

A material is rendered under one probe (the observation, with noise), reconstructed from the library without that
material and its family (classes refitted on the remaining columns), and rendered under every other probe. Methods are
named `single-X` (all columns in one class) and `classes-X` (the material classes) with X = lambda of eq. 25; `naive` is
plain least squares (single-0, least norm, torch.linalg.lstsq), `paper` is classes-0.5 and `auto` the estimator's
default.

Noise: pixel times (1 + s e) with e standard normal, independent for every pixel and channel. e depends on seed,
material and observing probe only, so results depend neither on the order nor on the choice of materials.
Targets are rendered with their own samples: another seed and 4 times as many a pixel as the basis images (with
--shared-samples the same: then nothing but `--noise` disturbs the observation).

OUT/rows holds one file a finished material, written whole or not at all: run the same command again to continue.
"""

import argparse
import itertools
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from paper.leave_one_out_report import Facts, write_report
from torchbrdf.brdf import columns_of
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.estimation.solvers import GramFactor, balance, prior_mean, ridge
from torchbrdf.experiments import (
    CellSample,
    Images,
    Scene,
    check_document,
    directional_scene,
    noisy_observations,
    read_rows,
    without_relatives,
    write_rows,
)
from torchbrdf.files import writing
from torchbrdf.transport import DEFAULT_SAMPLES

TARGET_SAMPLES = 4
"""Samples of a target, in units of those of the basis images."""

DIRECTIONAL_LIGHTS = (0, 136)
"""Angles in degrees from the camera of the directional lights of [CBP21, fig. 2]."""

COLUMNS = (
    "material", "observed", "novel", "noise_percent", "method", "class",
    "observation_error", "novel_error", "best_class_error",
    "light_0_error", "light_136_error", "log_error", "negative_share",
)  # fmt: skip


@dataclass(frozen=True)
class Method:
    """How to reconstruct: one class of all columns or the material classes, and lambda; None for penalty="auto"."""

    single: bool
    penalty: float | None

    @classmethod
    def named(cls, name: str) -> "Method":
        """`naive`, `paper`, `auto`, `single-X` or `classes-X`."""
        if name == "auto":
            return cls(False, None)
        kind, _, number = {"naive": "single-0", "paper": "classes-0.5"}.get(name, name).partition("-")
        try:
            penalty = float(number)
        except ValueError:
            penalty = -1.0
        if kind not in ("single", "classes") or not 0 <= penalty < float("inf"):
            known = "naive, paper, auto, single-X or classes-X with a number X >= 0"
            raise ValueError(f"method must be {known}, got {name!r}")
        return cls(kind == "single", penalty)

    @property
    def name(self) -> str:
        """As in results.csv."""
        if self.penalty is None:
            return "auto"
        if self.single and self.penalty == 0:
            return "naive"
        return f"{'single' if self.single else 'classes'}-{self.penalty:g}"


def candidates(scene: Scene, observations: Images, classes: Sequence[Tensor], penalties: Sequence[float]) -> Tensor:
    """Weights of every class [CBP21, eq. 26, Sigma' = identity], zero outside it.

    observations  of s noise levels
    classes       K tensors of column indices
    returns       (len(penalties), s, K, 3, n); penalty 0 is the least-squares solution of least norm
    """
    n_levels, n = len(observations.energy), scene.r.shape[-1]
    weights = torch.zeros(len(penalties), n_levels, len(classes), 3, n, dtype=torch.float64)
    for j, members in enumerate(classes):
        columns = scene.r[..., members]
        projection = torch.einsum("crm,scr->scm", columns, observations.coordinates)
        factor = None
        for i, penalty in enumerate(penalties):
            if penalty == 0:
                target = observations.coordinates.permute(1, 2, 0)
                solution = torch.linalg.lstsq(columns, target, driver="gelsd").solution.permute(2, 0, 1)
            else:
                if factor is None:
                    values, vectors = torch.linalg.eigh(columns.mT @ columns)
                    factor = GramFactor(values.clamp_min(0), vectors)
                strength = balance(penalty, observations.energy, len(members))
                solution = ridge(factor, projection, prior_mean(len(members), like=projection), strength)
            weights[i, :, j, :, members] = solution
    return weights


def match_classes(labels: Tensor, reference: Tensor, k: int) -> list[int]:
    """Which of k reference classes each class stands for: the assignment under which most columns agree."""
    counts = torch.zeros(int(labels.max()) + 1, k, dtype=torch.long)
    counts.index_put_((labels, reference), torch.ones_like(labels), accumulate=True)
    return linear_sum_assignment(counts.numpy(), maximize=True)[1].tolist()


@dataclass(frozen=True)
class Experiment:
    """Everything that all materials share.

    bases             the basis images of every probe
    scenes, targets   a Scene and the target images (m, 3, P) of every probe
    lights, lit       a Scene and the basis images (n, 3, P) of every directional light
    reference         (n,) the classes of the whole library
    """

    library: tb.MaterialLibrary
    bases: list[tb.BasisImages]
    scenes: list[Scene]
    targets: list[Tensor]
    lights: list[Scene]
    lit: list[Tensor]
    cells: CellSample
    reference: Tensor
    noise: Sequence[float]
    methods: Sequence[Method]
    n_classes: int
    seed: int

    def together(self) -> list[tuple[bool, list[Method]]]:
        """Methods that share their factors: those of one class, those of the material classes, and `auto`."""
        key = {method: (method.penalty is None, not method.single) for method in self.methods}  # auto, classes
        kinds = sorted(set(key.values()))
        return [(not kind[1], [method for method in self.methods if key[method] == kind]) for kind in kinds]

    def rows(self, material: str) -> list[dict[str, object]]:
        """The rows of results.csv for one material."""
        position = self.library.position(material)
        own = torch.arange(3 * position, 3 * position + 3)
        less = without_relatives(self.library, material)
        kept = columns_of([self.library.position(name) for name in less.names])
        classes = tb.MaterialClasses.fit(less, self.n_classes)
        members = [kept[classes.members(j)] for j in range(classes.n_classes)]
        meaning = match_classes(classes.labels, self.reference[kept], self.n_classes)
        lights = [
            (scene, scene.project(torch.stack([packed[own[c], c] for c in range(3)])))
            for scene, packed in zip(self.lights, self.lit, strict=True)
        ]
        novel = [
            scene.project(target[position].double()) for scene, target in zip(self.scenes, self.targets, strict=True)
        ]
        rows: list[dict[str, object]] = []
        for i, scene in enumerate(self.scenes):
            key = f"{self.seed} {material} {scene.name}"
            noisy = noisy_observations(self.targets[i][position].double(), self.noise, key)
            observations = scene.project(noisy)
            for single, methods in self.together():
                penalties = [method.penalty for method in methods if method.penalty is not None]
                if penalties:
                    w = candidates(scene, observations, [kept] if single else members, penalties)
                else:
                    estimator = tb.BRDFEstimator(self.bases[i].subset(less.names), classes, penalty="auto")
                    found = estimator(self.bases[i].unpack(noisy)).weights
                    w = found.new_zeros(1, len(noisy), 1, 3, self.library.n)
                    w[0, :, 0, :, kept] = found.mT
                residual = scene.error(w, Images(*(x[:, None] for x in vars(observations).values())))
                best = residual.argmin(-1)
                pick = best[..., None]
                chosen = w.gather(2, pick[..., None, None].expand(*pick.shape, 3, w.shape[-1]))[:, :, 0]
                measured = [s.error(chosen, target) for s, target in lights] + list(self.cells.compare(chosen, own))
                for k, other in enumerate(self.scenes):
                    if k == i:
                        continue
                    errors = other.error(w, novel[k])
                    for (a, method), (b, level) in itertools.product(enumerate(methods), enumerate(self.noise)):
                        j = int(best[a, b])
                        chosen_class = "" if single or not penalties else meaning[j]
                        names = (material, scene.name, other.name, f"{level:g}", method.name, chosen_class)
                        here = (residual[a, b, j], errors[a, b, j], errors[a, b].min(), *(x[a, b] for x in measured))
                        numbers = (f"{float(x):.6g}" for x in here)
                        rows.append(dict(zip(COLUMNS, (*names, *numbers), strict=True)))
        return rows


def open_probes(arguments: Sequence[str]) -> dict[str, tb.LightProbe]:
    """Probes by name: the stem of the file, or `default`."""
    probes: dict[str, tb.LightProbe] = {}
    for argument in arguments:
        name = Path(argument).stem
        if name in probes:
            raise ValueError(f"probes must have different names; {name!r} comes twice")
        probes[name] = tb.LightProbe.default() if argument == "default" else tb.LightProbe.open(argument, rows="poles")
    if len(probes) < 2:
        raise ValueError(f"at least two probes are needed (observed and novel), got {len(probes)}")
    return probes


def check_settings(path: Path, settings: dict[str, object]) -> None:
    """Write the settings into a new output folder; refuse one that holds results of other settings."""
    try:
        stored = json.loads(path.read_text())
    except FileNotFoundError:
        with writing(path) as temporary:
            temporary.write_text(json.dumps(settings, indent=1))
        return
    except ValueError:
        raise ValueError(f"{path}: damaged; choose another output folder") from None
    changed = [key for key in settings if stored.get(key) != settings[key]]
    if changed:
        raise ValueError(
            f"{path.parent} holds results with another {changed[0]} ({stored.get(changed[0])}, now "
            f"{settings[changed[0]]}); choose another output folder"
        )


def cached_basis(
    path: Path, library: tb.MaterialLibrary, probe: tb.LightProbe, view: tb.View, samples: int, seed: int
) -> tb.BasisImages:
    """Basis images from the cache, else rendered into it."""
    if not path.exists():
        tb.render_basis(library, probe, view, samples=samples, seed=seed, progress=True).save(path)
    return tb.BasisImages.load(path, library, probe, view)


def run(args: argparse.Namespace) -> None:
    """The whole experiment; raises ValueError or OSError for bad input."""
    started = time.perf_counter()
    if args.samples < 2 or args.classes < 1 or any(not 0 <= level < float("inf") for level in args.noise):
        raise ValueError("--samples must be at least 2, --classes at least 1, and noise levels at least 0")
    if find_spec("matplotlib") is None:
        raise ValueError("the plot needs matplotlib: install torchbrdf[experiments]")
    if args.document is not None:
        check_document(args.document)
    named = [*args.methods, *(f"{kind}-{x}" for x in args.penalties for kind in ("single", "classes"))]
    methods = list(dict.fromkeys(Method.named(name) for name in named))
    noise = list(dict.fromkeys(args.noise))
    probes = open_probes(args.probes)
    library = tb.MaterialLibrary.from_files(args.library)
    materials = list(dict.fromkeys(args.materials or library.names))
    for name in materials:
        library.position(name)
    view = tb.SphereView(args.size)
    out = Path(args.output)
    for folder in ("rows", "images"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    settings: dict[str, object] = {
        "library": library.source,
        "probes": {name: probe.fingerprint for name, probe in probes.items()},
        "noise": noise,
        "methods": [method.name for method in methods],
        "size": args.size,
        "samples": args.samples,
        "classes": args.classes,
        "seed": args.seed,
        "shared_samples": args.shared_samples,
        "version": tb.__version__,
    }
    check_settings(out / "settings.json", settings)

    bases, scenes, targets, shares = [], [], [], []
    for name, probe in tqdm(probes.items(), desc="probes", leave=False):
        basis = cached_basis(out / "images" / f"{name}.safetensors", library, probe, view, args.samples, args.seed)
        other = basis
        if not args.shared_samples:
            path = out / "images" / f"{name}_target.safetensors"
            other = cached_basis(path, library, probe, view, TARGET_SAMPLES * args.samples, args.seed + 1)
        bases.append(basis)
        scenes.append(Scene.of(name, basis.packed))
        own, target = (
            torch.stack([images.packed[c::3, c] for c in range(3)], dim=1) for images in (basis, other)
        )  # the material itself, each channel in its own colour of the light
        targets.append(target)
        shares.append((own - target).flatten(1).norm(dim=1) / target.flatten(1).norm(dim=1))
    lights, lit = zip(*(directional_scene(library, view, angle) for angle in DIRECTIONAL_LIGHTS), strict=True)
    reference = tb.MaterialClasses.fit(library, args.classes)
    experiment = Experiment(
        library, bases, scenes, targets, list(lights), list(lit), CellSample.of(library, args.seed),
        reference.labels, noise, methods, args.classes, args.seed,
    )  # fmt: skip

    paths = {material: out / "rows" / f"{material}.csv" for material in materials}
    finished = [material for material in materials if paths[material].exists()]
    with tqdm(total=len(materials), initial=len(finished), desc="materials") as bar:
        for material in materials:
            if material not in finished:
                write_rows(paths[material], experiment.rows(material))
                bar.update()
    rows = [row for material in materials for row in read_rows(paths[material])]
    write_rows(out / "results.csv", rows)
    share = torch.cat(shares)
    facts = Facts(
        materials=len(materials),
        size=args.size,
        samples=args.samples,
        targets="the same" if args.shared_samples else f"{TARGET_SAMPLES * args.samples} others",
        rendering_noise=(float(share.median()), float(share.quantile(0.95)), float(share.max())),
        class_sizes=reference.sizes,
        class_members=[
            [name for i, name in enumerate(library.names) if (reference.labels[3 * i : 3 * i + 3] == j).all()]
            for j in range(reference.n_classes)
        ],
    )
    write_report(out, rows, facts, args.document)
    print((out / "summary.md").read_text())
    seconds = time.perf_counter() - started
    new = len(materials) - len(finished)
    print(f"{out}: results.csv, summary.md, errors.png; {new} new materials in {seconds:.0f} s")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser(prog="leave_one_out", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", required=True, help="folder of MERL *.binary tables, or `default`")
    parser.add_argument("--probes", nargs="+", required=True, help="lat-long .exr or .hdr files, or `default`")
    parser.add_argument("-o", "--output", required=True, help="folder of the results")
    parser.add_argument("--noise", nargs="+", type=float, default=[0, 1, 2], help="levels in %% of the pixel's value")
    parser.add_argument("--methods", nargs="+", default=["naive", "single-0.5", "paper", "auto"])
    parser.add_argument("--penalties", nargs="+", default=[], help="further lambdas, each for one class and for all")
    parser.add_argument("--materials", nargs="+", help="only these; the library stays whole")
    parser.add_argument("--size", type=int, default=64, help="pixels along a side of the images")
    parser.add_argument("--samples", type=int, default=DEFAULT_SAMPLES, help="a pixel of the basis images")
    parser.add_argument("--classes", type=int, default=4, help="K, the number of material classes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--shared-samples", action="store_true", help="targets from the samples of the basis: no rendering noise"
    )
    parser.add_argument("--document", type=Path, help="Markdown file whose results, between markers, are replaced")
    return exit_status("leave_one_out", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
