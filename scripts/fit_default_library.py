#!/usr/bin/env python3
"""Fit the embedded default library: analytic parameters (torchbrdf.brdf.lobes) to a directory of MERL tables.

    python scripts/fit_default_library.py MERL_DIR [--output FILE] [--report FILE.md] [--checkpoint FILE]

Per colour channel, minimises a sum of means of |log(1 + f cos) - log(1 + g cos)| (over directions uniform
on both hemispheres, and over cells), |log(f + 0.002) - log(g + 0.002)| and the error of the albedo at normal
incidence, by Levenberg-Marquardt on iteratively reweighted residuals: from two starts, then from the
parameters of other columns that suit a column best, then on more samples. Quality is measured on samples of
another seed. Deterministic, for any number of threads; an interrupted fit goes on from its checkpoint when
called again.
"""

import hashlib
import json
import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor
from tqdm import tqdm

from lobe_fitting import (
    LOWER,
    N_PARAMETERS,
    SCALES,
    UPPER,
    Objective,
    Samples,
    State,
    cell_angles,
    minimise,
    to_parameters,
)
from torchbrdf.brdf import (
    N_CELLS,
    MerlTable,
    above_horizon,
    cell_centres,
    cell_index,
    from_half_difference,
    half_difference,
    nearest_measured,
    table_paths,
)
from torchbrdf.brdf.lobes import MODEL_VERSION, PARAMETER_NAMES, Parameters, evaluate_lobes, expand_row
from torchbrdf.command_line import Parser
from torchbrdf.files import cache_folder, writing

ROOT = Path(__file__).resolve().parent.parent
LOBES = 5
MIN_COSINE = 0.05
SEEDS = {"first": 1, "final": 2, "report": 3}
SAMPLES = {"first": (1500, 2500, 500, 1000), "final": (4000, 6000, 1000, 3000), "report": (20_000,) * 4}
"""Uniform directions, uniform cells away from the horizon, cells near it, cells drawn by `norm_shares`."""

ITERATIONS = {"start": 60, "exchange": 30, "final": 80}
BEGIN, END = "<!-- quality: begin (written by scripts/fit_default_library.py) -->", "<!-- quality: end -->"


def draw(seed: int, counts: tuple[int, int, int, int], norm_share: Tensor) -> Samples:
    """Samples without values (f_r is empty).

    norm_share  (N_CELLS,)  density by which the cells that estimate |f - g| are drawn
    """
    generator = torch.Generator().manual_seed(seed)
    nearest = nearest_measured(above_horizon())
    n_uniform, n_cells, n_horizon, n_norm = counts
    z, phi = torch.rand(2, 2, n_uniform, generator=generator, dtype=torch.float64)
    phi = 2 * math.pi * phi
    sine = torch.sqrt(1 - z**2)
    w_i, w_o = torch.stack([sine * torch.cos(phi), sine * torch.sin(phi), z], dim=-1)
    uniform = nearest[cell_index(*half_difference(w_i, w_o)).long()]

    z_i, z_o = (w[..., 2].reshape(-1) for w in from_half_difference(*cell_centres()))
    high = (z_i >= MIN_COSINE) & (z_o >= MIN_COSINE)
    chosen, low = (
        where[torch.randint(len(where), (count,), generator=generator)]
        for where, count in (
            (high.nonzero().ravel(), n_cells),
            ((above_horizon().reshape(-1) & ~high).nonzero().ravel(), n_horizon),
        )
    )
    u = torch.rand(n_norm, generator=generator, dtype=torch.float64) * norm_share.sum()
    peaks = torch.searchsorted(norm_share.cumsum(0), u).clamp_max(len(norm_share) - 1)

    # Albedo for w_o = n: theta_h = theta_d = theta_i / 2, phi_d = 0, dense towards the mirror direction.
    t = (torch.arange(20_000, dtype=torch.float64) + 0.5) / 20_000
    theta_i = t**2 * (math.pi / 2)
    solid_angle = 2 * math.pi * torch.sin(theta_i) * torch.cos(theta_i) * math.pi * t / len(t)
    line = nearest[cell_index(theta_i / 2, theta_i / 2, torch.zeros_like(t)).long()]
    line, which = line.unique(return_inverse=True)
    line_weight = torch.zeros(len(line), dtype=torch.float64).index_add_(0, which, solid_angle)

    def weights(*parts: Tensor | float) -> Tensor:
        lengths = (*counts, len(line))
        return torch.cat([torch.ones(n) * part for n, part in zip(lengths, parts, strict=True)]).float()

    kinds = {
        "uniform": weights(1 / n_uniform, 0, 0, 0, 0),
        "cells": weights(0, 1 / n_cells, 0, 0, 0),
        "relative": weights(0.2 / n_uniform, 1 / n_cells, 0.2 / n_horizon, 0, 0),
        "norm": weights(0, 0, 0, norm_share.mean() / norm_share[peaks] / n_norm, 0),
        "albedo": weights(0, 0, 0, 0, line_weight),
    }
    cosines = [w_i[:, 2], *(z_i[cells] for cells in (chosen, low, peaks, line))]
    cells = torch.cat([uniform, chosen, low, peaks, line])
    return Samples(cells, torch.cat(cosines).float(), kinds, torch.empty(0))


def norm_shares(paths: list[Path]) -> Tensor:
    """(N_CELLS,): the share of each cell in |g|^2, averaged over all columns; 0 below the horizon."""
    total = torch.zeros(N_CELLS, dtype=torch.float64)
    for path in tqdm(paths, desc="norms of tables", unit="table"):
        table = MerlTable.open(path)
        squares = torch.where(table.valid[..., None], table.values, 0).reshape(N_CELLS, 3) ** 2
        total += (squares / squares.sum(0)).sum(1)
    return total / (3 * len(paths))


def read_values(paths: list[Path], samples: list[Samples]) -> list[Samples]:
    """Fill in f_r of every sample from the tables."""
    wanted = torch.cat([s.cells for s in samples])
    values = []
    for path in tqdm(paths, desc="reading tables", unit="table"):
        values.append(MerlTable.open(path).filled[wanted].T.float())
    parts = torch.cat(values).split([len(s.cells) for s in samples], dim=1)
    return [replace(s, f_r=part.contiguous()) for s, part in zip(samples, parts, strict=True)]


def starts(samples: Samples, spread: float) -> Tensor:
    """A diffuse term and lobes of widths from that of the peak at normal incidence up to 0.15.

    spread   factor on the width of the narrowest lobe
    returns  (n, LOBES, N_PARAMETERS)
    """
    line = samples.weights["albedo"] > 0
    f_r, theta_h = samples.f_r[:, line], cell_angles(samples.cells[line])[0]
    order = theta_h.argsort()
    f_r, theta_h = f_r[:, order], theta_h[order]
    x = 2 * torch.sin(theta_h / 2) ** 2
    base = f_r[:, int((theta_h - 0.5).abs().argmin())].clamp_min(1e-4)
    peak = torch.maximum(f_r[:, :5].amax(1), 1.2 * base)
    below_half = f_r < ((peak + base) / 2)[:, None]
    width = x[below_half.float().argmax(1)].clamp(1e-7, 0.3).float()
    p = torch.zeros(len(f_r), LOBES, N_PARAMETERS)
    initial = {
        "decay": math.log(2),
        "exponent": math.log(4),
        "grazing": math.log(3),
        "softness": math.log(0.2),
        "masking": 0.2,
    }
    at = {name: i for i, name in enumerate(PARAMETER_NAMES)}
    for name, value in initial.items():
        p[..., at[name]] = value
    diffuse = {"decay": math.log(0.1), "grazing": math.log(1.5), "masking": 0.0}
    for name, value in diffuse.items():
        p[:, 0, at[name]] = value
    p[:, 0, at["strength"]] = base.log()
    for lobe in range(1, LOBES):
        r = (lobe - 1) / (LOBES - 2)
        p[:, lobe, at["width"]] = torch.log(0.7 * spread * width) * (1 - r) + math.log(0.15) * r
        p[:, lobe, at["strength"]] = torch.log(peak - base) * (1 - r) + torch.log(base) * r - 1
    return torch.minimum(torch.maximum(p, LOWER), UPPER)


class Checkpoint:
    """The finished stages of a fit and the one under way; ignored where tables or settings differ."""

    def __init__(self, path: Path, fingerprint: str) -> None:
        """Read what is there; `fingerprint` identifies tables and settings."""
        self.path, self.fingerprint = path, fingerprint
        self.done: dict[str, State] = {}
        if path.exists():
            stored = torch.load(path, weights_only=True)
            if stored["fingerprint"] == fingerprint:
                self.done = {name: State(**fields) for name, fields in stored["stages"].items()}

    def stage(
        self,
        name: str,
        first: Tensor,
        objective: Objective,
        columns: Tensor,
        iterations: int,
        eps: tuple[float, float],
    ) -> State:
        """Run or continue one minimisation that starts from the parameters `first`."""
        state = self.done.get(name) or State.start(first.clone())

        def save(current: State) -> None:
            self.done[name] = current
            stages = {key: vars(value) for key, value in self.done.items()}
            with writing(self.path) as temporary:
                torch.save({"fingerprint": self.fingerprint, "stages": stages}, temporary)

        return minimise(objective, state, columns, iterations, eps, name, save)


def fit(first: Samples, final: Samples, checkpoint: Checkpoint, workers: ThreadPoolExecutor) -> Tensor:
    """Parameters (n, LOBES, N_PARAMETERS): two starts, an exchange between columns, more samples."""
    objective, eps = Objective(first, workers), (1.0, 0.1)
    columns = torch.arange(len(first.f_r))
    best, loss = torch.empty(0), torch.full((len(columns),), torch.inf)
    for i, spread in enumerate((1.0, 6.0)):
        begin = starts(first, spread)
        state = checkpoint.stage(f"start {i + 1}", begin, objective, columns, ITERATIONS["start"], eps)
        best = torch.where((state.loss < loss)[:, None, None], state.p, best if i else begin)
        loss = torch.minimum(loss, state.loss)

    for i, donors in enumerate(nearest_donors(best, first, objective).unbind(1)):
        begin = best[donors]
        count = ITERATIONS["exchange"]
        state = checkpoint.stage(f"exchange {i + 1}", begin, objective, columns, count, (0.3, 0.1))
        best = torch.where((state.loss < loss)[:, None, None], state.p, best)
        loss = torch.minimum(loss, state.loss)
    objective = Objective(final, workers)
    return checkpoint.stage("final", best, objective, columns, ITERATIONS["final"], (0.2, 0.05)).p


def nearest_donors(p: Tensor, samples: Samples, objective: Objective, count: int = 2) -> Tensor:
    """(n, count): the other columns whose parameters suit each column best."""
    f_r = evaluate_lobes(to_parameters(p), *cell_angles(samples.cells)).T
    columns = torch.arange(len(p))

    def loss(donor: Tensor) -> Tensor:
        return objective.residuals(donor.expand_as(f_r), columns, 0.1).loss

    losses = torch.stack(list(objective.workers.map(loss, f_r)), dim=1)
    return losses.fill_diagonal_(torch.inf).topk(count, largest=False).indices


@dataclass(frozen=True)
class Quality:
    """Errors of each material (m,) on samples the fit has not seen."""

    uniform: Tensor
    cells: Tensor
    albedo: Tensor
    norm: Tensor

    @classmethod
    def measure(cls, parameters: Parameters, samples: Samples) -> "Quality":
        """Compare the model with the values of the samples."""
        angles = zip(*(a.split(4000) for a in cell_angles(samples.cells)), strict=True)
        f_r = torch.cat([evaluate_lobes(parameters, *a).T for a in angles], dim=1)
        error = (torch.log1p(f_r * samples.cos_i) - torch.log1p(samples.f_r * samples.cos_i)).abs()
        weights = samples.weights
        uniform, cells = error @ weights["uniform"], error @ weights["cells"]
        albedo = (f_r @ weights["albedo"] / (samples.f_r @ weights["albedo"]) - 1).abs()
        norm = torch.sqrt((f_r - samples.f_r) ** 2 @ weights["norm"] / (samples.f_r**2 @ weights["norm"]))
        by_material = [x.reshape(-1, 3) for x in (uniform, cells, albedo, norm)]
        return cls(by_material[0].mean(1), by_material[1].mean(1), by_material[2].amax(1), by_material[3].amax(1))

    def table(self, names: list[str]) -> str:
        """Markdown: the criteria, then every material."""
        rows = ["| criterion | median | worst | worst materials |", "|---|---|---|---|"]
        criteria = (
            ("(1) uniform directions", self.uniform, ".5f"),
            ("(2) cells", self.cells, ".4f"),
            ("(3) albedo at normal incidence", self.albedo, ".3%"),
            ("(4) norm of the difference", self.norm, ".1%"),
        )
        for label, error, form in criteria:
            worst = ", ".join(f"{names[i]} {error[i]:{form}}" for i in error.argsort(descending=True)[:6].tolist())
            rows.append(f"| {label} | {error.median():{form}} | {error.max():{form}} | {worst} |")
        rows += [
            "",
            f"Albedo within 10 % in every channel: {int((self.albedo < 0.1).sum())} of {len(names)}.",
            "",
            "| material | (1) | (2) | (3) | (4) |",
            "|---|---|---|---|---|",
        ]
        rows += [
            f"| {name} | {a:.5f} | {b:.4f} | {c:.2%} | {d:.1%} |"
            for name, a, b, c, d in zip(
                names, *(x.tolist() for x in (self.uniform, self.cells, self.albedo, self.norm)), strict=True
            )
        ]
        return "\n".join(rows)


def expansion_seconds(parameters: Parameters) -> float:
    """Time to evaluate every column on the whole grid."""
    started = time.perf_counter()
    for theta_h in cell_centres()[0].ravel().tolist():
        expand_row(parameters, theta_h)
    return time.perf_counter() - started


def main() -> None:
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("directory", type=Path, help="MERL *.binary tables")
    parser.add_argument("--output", type=Path, default=ROOT / "torchbrdf" / "default_library.safetensors")
    parser.add_argument(
        "--report",
        type=Path,
        default=ROOT / "docs" / "results" / "default_library.md",
        help="Markdown file whose quality table is replaced",
    )
    parser.add_argument("--checkpoint", type=Path, help="default: in the cache folder; removed at the end")
    parser.add_argument("--source", default="unnamed tables", help="where the tables come from, kept in the file")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    torch.set_num_threads(1)  # workers share out the columns: the same result for any number

    paths = table_paths(args.directory)
    names = [path.stem for path in paths]
    shares = norm_shares(paths)
    drawn = [draw(SEEDS[key], SAMPLES[key], shares) for key in ("first", "final", "report")]
    first, final, report = read_values(paths, drawn)
    tables = hashlib.sha256(final.f_r.numpy().tobytes()).hexdigest()
    settings = repr((MODEL_VERSION, LOBES, SEEDS, SAMPLES, ITERATIONS, SCALES, names, tables))
    path = args.checkpoint or cache_folder() / "fit_default_library.checkpoint"
    path.parent.mkdir(parents=True, exist_ok=True)
    checkpoint = Checkpoint(path, hashlib.sha256(settings.encode()).hexdigest())

    started = time.perf_counter()
    with ThreadPoolExecutor(args.threads) as workers:
        parameters = to_parameters(fit(first, final, checkpoint, workers))
    torch.set_num_threads(args.threads)
    metadata = {
        "names": json.dumps(names),
        "model_version": str(MODEL_VERSION),
        "source": args.source,
        "sha256_of_fitted_samples": tables,
        "script": "scripts/fit_default_library.py",
        "torch": torch.__version__,
    }
    with writing(args.output) as temporary:
        save_file(parameters, temporary, metadata)
    table = Quality.measure(parameters, report).table(names)
    print(table)
    print(
        f"fit: {time.perf_counter() - started:.0f} s (this run); expansion of {3 * len(names)} columns: "
        f"{expansion_seconds(parameters):.1f} s, {args.threads} threads; {args.output.stat().st_size} bytes"
    )
    text = args.report.read_text() if args.report.exists() else ""
    if BEGIN in text:
        args.report.write_text(text.split(BEGIN)[0] + BEGIN + "\n" + table + "\n" + END + text.split(END)[1])
    path.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
