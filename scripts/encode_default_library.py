#!/usr/bin/env python3
"""Encode the embedded default library (torchbrdf.brdf.tucker): tables, such as those of MERL's materials.

    python scripts/encode_default_library.py merl --source "how the tables were made"

Tables are `.binary`, or `.bsdf` of the RGL database, whose names lose `_rgb`. Cells that were not measured are taken
from the decomposition itself, again and again. Deterministic; 100 materials take 80 seconds on two cores, and 8 GB.
The page of quality is rewritten, every material with its errors in the three metrics of `torchbrdf.brdf.METRICS`.
"""

import argparse
import json
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor
from tqdm import tqdm

from torchbrdf.brdf import (
    GRID,
    METRICS,
    N_CELLS,
    RGL_SUFFIX,
    TABLE_SUFFIX,
    MerlTable,
    above_horizon,
    cell_difference,
    read_table,
)
from torchbrdf.brdf.tucker import DEFAULT_FILE, TuckerFactors, logarithm
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import check_document, markdown_table, percent, replace_results
from torchbrdf.files import writing

ROOT = Path(__file__).resolve().parent.parent
PROFILES = (48, 32, 20)
"""Of theta_h, theta_d and phi_d."""

SMOOTH = (24, 16, 8)
"""Those from which cells that were not measured are filled."""

FILLS = 6
TERMS = 6000
LARGEST = 32767


def modes(logarithms: Tensor) -> list[Tensor]:
    """Orthonormal profiles (90, 90), (90, 90), (180, 180) of columns (n, 90, 90, 180), those of most energy first."""
    scatter = [torch.zeros(length, length, dtype=torch.float64) for length in GRID]
    for column in tqdm(logarithms, desc="profiles", leave=False):
        for axis, total in enumerate(scatter):
            along = column.movedim(axis, 0).flatten(1)
            total += (along @ along.T).double()
    return [torch.linalg.eigh(total)[1].flip(1).float() for total in scatter]


def projected(column: Tensor, profiles: Sequence[Tensor]) -> Tensor:
    """(A, B, C): coefficients of a column (90, 90, 180)."""
    return torch.einsum("hdp,ha,db,pc->abc", column, *profiles)


def filled(logarithms: Tensor, valid: Tensor) -> list[Tensor]:
    """The profiles, after cells that were not measured have come to agree with them; these change in place.

    valid  (m, 90, 90, 180), three columns each
    """
    profiles = modes(logarithms)
    for _ in range(FILLS):
        smooth = [profile[:, :count] for profile, count in zip(profiles, SMOOTH, strict=True)]
        for i, column in enumerate(tqdm(logarithms, desc="holes", leave=False)):
            guess = torch.einsum("abc,ha,db,pc->hdp", projected(column, smooth), *smooth)
            column[~valid[i // 3]] = guess[~valid[i // 3]]
        profiles = modes(logarithms)
    return [profile[:, :count].contiguous() for profile, count in zip(profiles, PROFILES, strict=True)]


def encode(tables: Sequence[MerlTable]) -> TuckerFactors:
    """Decompose tables, and keep the terms of most energy."""
    logarithms, valid = torch.empty(3 * len(tables), *GRID), torch.stack([table.valid for table in tables])
    for i, table in enumerate(tables):
        logarithms[3 * i : 3 * i + 3] = logarithm(table.filled).T.reshape(3, *GRID)
    profiles = filled(logarithms, valid)
    core = torch.stack([projected(column, profiles) for column in logarithms], -1).flatten(0, 2)  # (A B C, n)
    terms = core.square().sum(1).topk(TERMS).indices.sort().values
    kept = core[terms]
    step = (kept.abs().amax(1) / LARGEST).clamp_min(1e-30)
    sizes = [profile.shape[1] for profile in profiles]
    places = torch.stack(torch.unravel_index(terms, sizes), 1).short()
    theta_h, theta_d, phi_d = profiles
    return TuckerFactors(theta_h, theta_d, phi_d, places, (kept / step[:, None]).round().short(), step)


def quality(tables: Sequence[MerlTable], factors: TuckerFactors) -> list[tuple[str, list[float]]]:
    """Every material's differences in the metrics, over the cells that were measured."""
    decoded = torch.empty(N_CELLS, 3 * len(tables))
    for i, rows in enumerate(decoded.split(GRID[1] * GRID[2])):
        rows.copy_(factors.row(i))
    found = []
    for i, table in enumerate(tqdm(tables, desc="quality", leave=False)):
        own = MerlTable(decoded[:, 3 * i : 3 * i + 3].reshape(*GRID, 3), above_horizon(), table.name)
        found.append((table.name, [cell_difference(own, table, metric) for metric in METRICS]))
    return found


def page(found: Sequence[tuple[str, list[float]]], measured: set[str]) -> str:
    """A summary, and a row for each material."""
    errors = list(zip(*(errors for _, errors in found), strict=True))
    worst = [max(found, key=lambda one: one[1][k]) for k in range(len(METRICS))]
    head = ["", *METRICS]
    summary = [
        ["median", *(percent(statistics.median(some)) for some in errors)],
        ["worst", *(f"{percent(one[1][k])}, {one[0]}" for k, one in enumerate(worst))],
    ]
    rows = [[name, "RGL" if name in measured else "MERL", *map(percent, some)] for name, some in found]
    return f"{markdown_table(head, summary)}\n\n{markdown_table(['material', 'from', *METRICS], rows)}"


def run(options: argparse.Namespace) -> None:
    check_document(options.report)
    files = [path for folder in options.folders for path in sorted(folder.iterdir())]
    paths = [path for path in files if path.suffix in (TABLE_SUFFIX, RGL_SUFFIX)]
    tables = []
    for path in tqdm(paths, desc="tables", leave=False):
        table = read_table(path)
        tables.append(MerlTable(table.values.float(), table.valid, table.name.removesuffix("_rgb")))
    factors = encode(tables)
    with writing(options.output) as temporary:
        metadata = {"names": json.dumps([table.name for table in tables]), "source": options.source}
        save_file(factors.tensors, temporary, metadata)
    measured = {path.stem.removesuffix("_rgb") for path in paths if path.suffix == RGL_SUFFIX}
    replace_results(options.report, page(quality(tables, factors), measured))
    print(f"wrote {options.output}, {options.output.stat().st_size:,} bytes, and {options.report}")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="of tables, .binary or .bsdf")
    parser.add_argument("--source", required=True, help="how the tables were made, kept in the file")
    parser.add_argument("--output", type=Path, default=ROOT / "torchbrdf" / "brdf" / DEFAULT_FILE)
    parser.add_argument("--report", type=Path, default=ROOT / "docs" / "results" / "default_library.md")
    return exit_status("encode_default_library", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
