#!/usr/bin/env python3
"""Claim: every part of the default estimator earns its place, and its constants were chosen on other materials.

    python scripts/benchmarks/ablation.py --library merl --targets targets --noise 1 0 \
        --document docs/results/ablation.md

Three sets of cases, novel-light error in per cent (mean, 90 %, worst) for each variation of the default:

tuning    every tenth material of `--library`, left out of it, under `--tuning-probes`: constants were chosen here
crossed   the same materials, left out of the *embedded* library, whose BRDFs are an encoding: here, too
reported  measured materials of `--targets` that no library holds, under all their probes: nothing was chosen here

Basis images are of the precomputed transport, whatever the cache holds; tuning images are sampled, four times as many
a pixel as by default. One line changes one thing.
"""

import argparse
import contextlib
import statistics
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.estimation import ImageSpace, Penalty, image_space, residual_scale, smooth_errors as shared_errors
from torchbrdf.estimation.priors import Explanation, PriorBank, bank, neighbourhoods, prior_variances, whole_library
from torchbrdf.experiments import (
    by_relatives,
    check_document,
    default_probes,
    markdown_table,
    noisy_observations,
    open_probes,
    read_targets,
    replace_results,
)
from torchbrdf.images import relative_rms
from torchbrdf.transport import DEFAULT_SAMPLES

TUNING_PROBES = ("default", "uffizi", "forest", "grace")
EVERY = 10

K = 4
"""Priors of a bank: K classes, then the whole library, then neighbourhoods."""

Rule = Callable[[Explanation, Tensor], Tensor]
"""Shares (B, M, L) of priors and penalties for photographs (B, 3, P)."""


def evidence(first: int = 0, last: int | None = None) -> Rule:
    """Averaged by evidence over the priors first ... last - 1."""

    def rule(found: Explanation, _: Tensor) -> Tensor:
        some = torch.zeros_like(found.shares)
        some[:, first:last] = found.shares[:, first:last]
        return some / some.sum((1, 2), keepdim=True)

    return rule


def most_probable(found: Explanation, _: Tensor) -> Tensor:
    """Only the pair of prior and penalty with the largest evidence."""
    return one_hot(found.log_evidence)


def one_hot(score: Tensor) -> Tensor:
    """1 at the largest score (B, M, L) of each photograph."""
    best = torch.nn.functional.one_hot(score.flatten(1).argmax(1), score[0].numel())
    return best.reshape(score.shape).double()


def cross_validated(every_pixel: bool) -> Rule:
    """The penalty of the whole library by generalised cross-validation [GHW79] or by leaving out each pixel in turn."""

    def rule(found: Explanation, y: Tensor) -> Tensor:
        bank, m = found.bank, K
        spectrum = bank.values[m][:, None] + bank.penalties[m][..., None]  # (3, L, r)
        gain = bank.values[m][:, None] / spectrum
        coordinates, energy = bank.space.project(y)
        outside = energy - coordinates.square().sum(-1)
        score = torch.full_like(found.log_evidence, -torch.inf)
        if not every_pixel:
            residual = outside[..., None] + torch.einsum(
                "bsk,slk->bsl", found.deviation[:, m].square(), (1 - gain).square()
            )
            free = y.shape[-1] - gain.sum(-1)
            score[:, m] = -(residual / free.square()).sum(1)
            return one_hot(score)
        directions = bank.space.u.double() @ bank.vectors[m]  # (3, P, r)
        weighted = y / bank.space.scale
        unseen = weighted - torch.einsum("spr,bsr->bsp", bank.space.u.double(), coordinates)
        for k in range(bank.penalties.shape[-1]):
            leverage = torch.einsum("spr,sr->sp", directions.square(), gain[:, k])
            missed = torch.einsum("spr,bsr->bsp", directions, found.deviation[:, m] * (1 - gain[:, k]))
            score[:, m, k] = -((unseen + missed) / (1 - leverage)).square().sum((-2, -1))
        return one_hot(score)

    return rule


@dataclass(frozen=True)
class Variation:
    """One thing changed.

    constants   name -> value in torchbrdf.estimation.image_space or in a module of torchbrdf.estimation.priors
    rule        how priors and penalties are weighed
    own         a neighbourhood around the photograph itself is added for every photograph
    photograph  residuals are divided by photograph + 0.3 mean instead of the mean basis image
    fixed       arguments of BRDFEstimator and, with one_class, of one class of all columns instead
    """

    name: str
    constants: Mapping[str, object] = field(default_factory=dict)
    rule: Rule = field(default_factory=evidence)
    own: bool = False
    photograph: bool = False
    fixed: Penalty | None = None
    one_class: bool = False


WHITE = {"SIZE": 0.0}
"""Cross-validation is of pixels whose errors are their own."""

VARIATIONS = (
    Variation("**default**"),
    Variation("fixed: paper (four classes, 0.5)", fixed="paper"),
    *(Variation(f"fixed: one class, {x:g}", fixed=x, one_class=True) for x in (0.05, 0.005, 0.0005)),
    Variation("lambda by generalised cross-validation, whole library", WHITE, cross_validated(False)),
    Variation("lambda by leaving out pixels, whole library", WHITE, cross_validated(True)),
    Variation("priors: classes only", rule=evidence(0, K)),
    Variation("priors: whole library only", rule=evidence(K, K + 1)),
    Variation("priors: neighbourhoods only", rule=evidence(K + 1)),
    Variation("priors: without neighbourhoods", rule=evidence(0, K + 1)),
    Variation("the most probable prior and penalty, no average", rule=most_probable),
    Variation("a neighbourhood of the photograph itself, too", own=True),
    Variation("residuals not weighted", {"DARKEST": 1e6}),
    Variation("residuals weighted by the photograph", photograph=True),
    *(Variation(f"DARKEST {x:g}", {"DARKEST": x}) for x in (0.1, 1.0)),
    *(Variation(f"TRUSTED {x:g}", {"TRUSTED": x}) for x in (0.5, 1.0, 4.0, 16.0)),
    Variation("evidence as it is (TRUSTED without end)", {"TRUSTED": 1e9}),
    *(Variation(f"CORRELATION {x:g}", {"CORRELATION": x}) for x in (1.0, 4.0, 16.0, 32.0)),
    Variation("no shared errors", WHITE),
    *(Variation(f"shared errors: SIZE {x:g}", {"SIZE": x}) for x in (0.05, 0.1, 0.2, 0.4)),
    *(Variation(f"shared errors: REACH {x:g}", {"REACH": x}) for x in (0.7, 1.5)),
    *(Variation(f"NOISE_FLOOR {x:g}", {"NOISE_FLOOR": x}) for x in (0.0, 0.006, 0.012)),
    *(Variation(f"NEIGHBOURHOODS {x}", {"NEIGHBOURHOODS": x}) for x in (5, 20)),
    *(Variation(f"REACHES {x}", {"REACHES": x}) for x in ((0.1,), (0.2,), (0.4,), (0.2, 0.4, 0.8))),
    *(Variation(f"POWER {x:g}", {"POWER": x}) for x in (0.0, 0.5)),
    Variation("28 penalties from 1e-9", {"PENALTIES": torch.logspace(-9, 1, 28, dtype=torch.float64)}),
    *(Variation(f"CUT {x:g}", {"CUT": x}) for x in (1e-5, 2e-4)),
)


_CONSTANTS = (image_space, shared_errors, bank, neighbourhoods, whole_library)


@contextlib.contextmanager
def changed(constants: Mapping[str, object]) -> Iterator[None]:
    """Other values for constants of the package."""
    with contextlib.ExitStack() as stack:
        for name, value in constants.items():
            module = next(one for one in _CONSTANTS if hasattr(one, name))
            stack.enter_context(mock.patch.object(module, name, value))
        yield


def fit(variation: Variation, basis: tb.BasisImages, classes: tb.MaterialClasses, y: Tensor) -> Tensor:
    """Weights (B, n, 3) of photographs (B, 3, P)."""
    if variation.fixed is not None:
        estimator = tb.BRDFEstimator(basis, classes, variation.fixed)
        return estimator(basis.unpack(y)).weights
    with changed(variation.constants):
        space = ImageSpace.of(basis.packed, [y.shape[-1]], shared_errors.smooth_errors([basis.mask]))
        variances = prior_variances(classes.membership, classes.norms, space)
        if variation.photograph:
            return torch.cat([fit_own_scale(variation, basis, variances, one[None]) for one in y])
        if variation.own:
            return torch.cat([average(variation, own_bank(space, variances, one), one[None]) for one in y])
        return average(variation, PriorBank.of(space, variances, bank.CORRELATION), y)


def average(variation: Variation, bank: PriorBank, y: Tensor) -> Tensor:
    found = bank.explain(y)
    shares = variation.rule(found, y)
    return found.components(shares).sum(1).mT


def own_bank(space: ImageSpace, variances: Tensor, y: Tensor) -> PriorBank:
    """All priors, and one that fades with each basis image's angle to the photograph (3, P)."""
    coordinates, energy = space.project(y[None])
    cosine = torch.einsum("sr,srn->sn", coordinates[0], space.r) / (energy[0][:, None] * space.energy).sqrt()
    angles = torch.acos(cosine.clamp(-1, 1)).mean(0)
    own = torch.exp(-((angles / neighbourhoods.REACHES[0]) ** 2)) * variances[K]
    return PriorBank.of(space, torch.cat([variances, own[None] / own.mean()]), bank.CORRELATION)


def fit_own_scale(variation: Variation, basis: tb.BasisImages, variances: Tensor, y: Tensor) -> Tensor:
    """Residuals of one photograph (1, 3, P) divided by itself instead of the mean basis image."""
    scale = residual_scale(y[0].clamp_min(0), [y.shape[-1]])
    space = ImageSpace.weighted(basis.packed, scale, shared_errors.smooth_errors([basis.mask]))
    return average(variation, PriorBank.of(space, variances, bank.CORRELATION), y)


@dataclass(frozen=True)
class Photographs:
    """Photographs (m, 3, P) of some materials under one probe, and the library to recover each from, less its family.

    bases    probe -> basis images
    images   probe -> (m, 3, P)
    """

    library: tb.MaterialLibrary
    materials: Sequence[str]
    bases: Mapping[str, tb.BasisImages]
    images: Mapping[str, Tensor]
    fitted: dict[tuple[object, ...], tb.MaterialClasses] = field(default_factory=dict)

    def classes(self, library: tb.MaterialLibrary, n_classes: int) -> tb.MaterialClasses:
        """Fitted once for each library."""
        key = (library.names, n_classes)
        if key not in self.fitted:
            self.fitted[key] = tb.MaterialClasses.fit(library, n_classes)
        return self.fitted[key]

    def errors(self, variation: Variation, levels: Sequence[float]) -> list[list[float]]:
        """Novel-light errors of all cases, at each level of noise: one factorisation serves them all."""
        found: list[list[float]] = [[] for _ in levels]
        for dropped, materials in by_relatives(self.materials, self.library.names).items():
            rows = [self.materials.index(material) for material in materials]
            classes = self.classes(self.library.without(*dropped), 1 if variation.one_class else K)
            for probe, basis in self.bases.items():
                y = torch.stack(
                    [noisy_observations(self.images[probe][i], levels, f"{self.materials[i]} {probe}") for i in rows], 1
                )
                weights = fit(variation, basis.without(*dropped), classes, y.flatten(0, 1))
                weights = weights.double().unflatten(0, y.shape[:2])
                for novel, other in self.bases.items():
                    if novel == probe:
                        continue
                    rendered = torch.einsum("kbnc,ncp->kbcp", weights, other.without(*dropped).packed.double())
                    for errors, images in zip(found, rendered, strict=True):
                        errors += [relative_rms(a, self.images[novel][i]) for a, i in zip(images, rows, strict=True)]
        return found


def tuning_set(
    library: tb.MaterialLibrary,
    materials: Sequence[str],
    truth: tb.MaterialLibrary,
    probes: Mapping[str, tb.LightProbe],
) -> Photographs:
    """Materials of `truth`, rendered with their own samples, to be recovered from a library without them."""
    view = tb.SphereView(64)
    bases = {name: tb.render_basis(library, probe, view, "harmonic") for name, probe in probes.items()}
    some = truth.subset(materials)
    images = {}
    for k, (name, probe) in enumerate(probes.items()):
        rendered = tb.render_basis(some, probe, view, samples=4 * DEFAULT_SAMPLES, seed=1 + k)
        images[name] = torch.stack([view.pack(rendered.image(material)) for material in materials]).double()
    return Photographs(library, materials, bases, images)


def reported_set(library: tb.MaterialLibrary, folder: Path) -> Photographs:
    """The targets of scripts/make_targets.py."""
    targets = read_targets(folder)
    names = sorted({target.material for target in targets})
    view, bases, images = tb.SphereView(targets[0].size), {}, {}
    for name, probe in open_probes(default_probes()).items():
        mine = {target.material: target for target in targets if target.probe_fingerprint == probe.fingerprint}
        bases[name] = tb.render_basis(library, probe, view, "harmonic")
        images[name] = torch.stack([view.pack(mine[material].photograph) for material in names]).double()
    return Photographs(library, names, bases, images)


def tables(sets: Mapping[str, Photographs], variations: Sequence[Variation], levels: Sequence[float]) -> str:
    """A table a level of noise, with a row a variation."""
    head = ["variation"]
    for name in sets:
        head += [f"{name}: mean", "90 %", "worst"]
    rows: list[list[list[str]]] = [[] for _ in levels]
    for variation in tqdm(variations, leave=False):
        found = [photographs.errors(variation, levels) for photographs in sets.values()]
        for level, of_sets in zip(rows, zip(*found, strict=True), strict=True):
            row = [variation.name]
            for errors in of_sets:
                some = sorted(100 * error for error in errors)
                row += [f"{statistics.mean(some):.2f}", f"{some[int(0.9 * len(some))]:.1f}", f"{some[-1]:.1f}"]
            level.append(row)
    parts = zip(levels, rows, strict=True)
    return "\n\n".join(f"{level:g} % pixel noise:\n\n{markdown_table(head, some)}" for level, some in parts)


def run(options: argparse.Namespace) -> None:
    if options.document is not None:
        check_document(options.document)
    measured, embedded = tb.MaterialLibrary.from_merl(options.library), tb.MaterialLibrary.default()
    known = open_probes(default_probes()) | {"default": tb.LightProbe.default()}
    probes = {name: known[name] for name in options.tuning_probes}
    materials = list(measured.names[:: options.every])
    missing = [name for name in materials if name not in embedded.names]
    if missing:
        raise ValueError(f"{options.library}: {missing[0]} is not in the embedded library; give the MERL materials")
    sets = {
        "tuning": tuning_set(measured, materials, measured, probes),
        "crossed": tuning_set(embedded, materials, measured, probes),
        "reported": reported_set(measured, options.targets),
    }
    variations = [v for v in VARIATIONS if not options.only or any(text in v.name for text in options.only)]
    body = tables(sets, variations, options.noise)
    print(body)
    if options.document is not None:
        replace_results(options.document, body)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", required=True, type=Path, help="folder of MERL *.binary tables")
    parser.add_argument("--targets", required=True, type=Path, help="folder that make_targets.py wrote")
    parser.add_argument("--tuning-probes", nargs="+", default=list(TUNING_PROBES), metavar="NAME")
    parser.add_argument("--every", type=int, default=EVERY, help="how many materials of the library to skip")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0], help="in %% of every pixel")
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="variations whose names contain one of these")
    parser.add_argument("--document", type=Path, help="Markdown file whose results, between markers, are replaced")
    options = parser.parse_args(argv)
    return exit_status("ablation", run, options)


if __name__ == "__main__":
    sys.exit(main())
