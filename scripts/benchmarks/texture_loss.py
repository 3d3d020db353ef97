"""What a table loses on its way to the browser (docs/compare.md).

    python scripts/benchmarks/texture_loss.py merl/brass.binary [more.binary ...]

Prints one row a table: the relative difference of the table that the browser's texture holds from the whole one, by
metric, and beside it that of a table folded to phi_d in [0, 90] degrees, as mirror symmetry would have it.
"""

from dataclasses import replace
from pathlib import Path

import torch

from torchbrdf.brdf import GRID, METRICS, MerlTable, brdf_texture, cell_difference
from torchbrdf.brdf.texture import LAYERS
from torchbrdf.command_line import Parser


def from_texture(table: MerlTable) -> MerlTable:
    """The table as a browser filters its texture, at the centres of the cells."""
    texture, scale = brdf_texture(table)
    layers = torch.from_numpy(texture.astype("f8") * scale).permute(2, 1, 0, 3)
    place = (torch.arange(GRID[2]) + 0.5) * (LAYERS / GRID[2]) - 0.5
    lower = place.floor()
    values = torch.lerp(
        layers[:, :, lower.long() % LAYERS],
        layers[:, :, (lower.long() + 1) % LAYERS],
        (place - lower).double()[:, None],
    )
    return replace(table, values=values)


def folded(table: MerlTable) -> MerlTable:
    """The mean of the cells at phi_d and pi - phi_d, in all of both."""
    values = table.filled.reshape(*GRID, 3)
    return replace(table, values=(values + values.flip(2)) / 2)


def main() -> None:
    """See the module."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("tables", type=Path, nargs="+")
    print("| material |" + "".join(f" {metric} |" for metric in METRICS) + "".join(f" folded, {m} |" for m in METRICS))
    print("|---|" + "---:|" * (2 * len(METRICS)))
    for path in parser.parse_args().tables:
        table = MerlTable.open(path)
        changed = (from_texture(table), folded(table))
        losses = [cell_difference(other, table, metric) for other in changed for metric in METRICS]
        print(f"| {table.name} |" + "".join(f" {loss:.2%} |" for loss in losses), flush=True)


if __name__ == "__main__":
    main()
