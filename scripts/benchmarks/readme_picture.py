"""The picture of the README: photographs of three balls, and the recovered BRDFs under a light they never saw.

Run `python scripts/benchmarks/readme_picture.py`; it needs no data and writes docs/figures/recovered.png. Each
material is recovered from the others of the embedded library, from one simulated photograph with noise.
"""

from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

import torchbrdf as tb
from torchbrdf.command_line import Parser
from torchbrdf.images import tone_map
from torchbrdf.light import area_mean

MATERIALS = ("gold-metallic-paint2", "specular-blue-phenolic", "pink-fabric")
PHOTOGRAPH = 64
TILE = 160
SUPERSAMPLING = 2
NOISE = 0.01
"""Standard deviation of the photographs' noise, relative to each pixel."""


def sky() -> tb.LightProbe:
    """A clear evening: a low sun, a sky that is orange at the horizon and blue above, dark ground."""
    return tb.LightProbe(area_mean(_sky_radiance, 128, 256, 8), name="evening sky")


def _sky_radiance(directions: Tensor) -> Tensor:
    up = directions[..., 1:2]
    glow = torch.exp(-6 * up.clamp_min(0))
    above = torch.lerp(torch.tensor([0.22, 0.46, 1.1]), torch.tensor([2.8, 1.6, 0.8]), glow)
    radiance = torch.where(up > 0, above, torch.tensor([0.12, 0.11, 0.10]))
    sun = torch.nn.functional.normalize(torch.tensor([-0.65, 0.45, 0.62]), dim=0)
    from_sun = 2 * torch.asin(torch.linalg.vector_norm(directions - sun, dim=-1, keepdim=True) / 2)
    return torch.where(from_sun < np.radians(1.5), torch.tensor([1500.0, 1100.0, 700.0]), radiance)


def picture(table: tb.MerlTable, probe: tb.LightProbe) -> Tensor:
    """(3, TILE, TILE) display values on white; the rim is smooth because the sphere is rendered larger."""
    view = tb.SphereView(TILE * SUPERSAMPLING)
    shown = torch.where(view.mask, tone_map(tb.render(table, probe, view, samples=384)), 1.0)
    return torch.nn.functional.avg_pool2d(shown, SUPERSAMPLING)


def enlarged(photograph: Tensor, view: tb.View) -> Tensor:
    """(3, TILE, TILE) display values of a photograph, pixel for pixel, on white."""
    shown = torch.where(view.mask, tone_map(photograph), 1.0)
    return torch.nn.functional.interpolate(shown[None], TILE)[0]


def relative_error(got: Tensor, expected: Tensor) -> float:
    """|got - expected| / |expected|."""
    return float((got - expected).norm() / expected.norm())


def main() -> None:
    """Recover, render and write the picture; print the errors."""
    parser = Parser(description=main.__doc__)
    default = Path(__file__).resolve().parents[2] / "docs" / "figures" / "recovered.png"
    parser.add_argument("-o", "--output", type=Path, default=default)
    output: Path = parser.parse_args().output

    whole = tb.MaterialLibrary.default()
    room, novel = tb.LightProbe.default(), sky()
    view = tb.SphereView(PHOTOGRAPH)
    basis = tb.render_basis(whole, room, view, progress=True)
    rows = []
    for seed, name in enumerate(MATERIALS):
        library = whole.without(name)
        truth = whole.table(name)
        clean = tb.render(truth, room, view, seed=1)
        noise = torch.randn(clean.shape, generator=torch.Generator().manual_seed(seed))
        photograph = clean * (1 + NOISE * noise)
        result = tb.BRDFEstimator(basis.without(name), tb.MaterialClasses.fit(library))(photograph)
        recovered = result.brdf(library)
        error = relative_error(tb.render(recovered, novel, view, seed=2), tb.render(truth, novel, view, seed=3))
        print(f"{name}: error {float(result.relative_error):.3f} on the photograph, {error:.3f} under the new light")
        tiles = [enlarged(photograph, view)] + [
            picture(*pair) for pair in ((recovered, room), (recovered, novel), (truth, novel))
        ]
        rows.append(tiles)
    write(output, rows)


def write(path: Path, rows: list[list[Tensor]]) -> None:
    """A grid of tiles at one screen pixel a pixel, with titles."""
    titles = ("photograph", "recovered BRDF,\nsame light", "recovered BRDF,\nnew light", "truth,\nnew light")
    gap, top, left = 10, 44, 26
    width, height = left + len(titles) * (TILE + gap), top + len(rows) * (TILE + gap)
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    for i, (name, tiles) in enumerate(zip(MATERIALS, rows, strict=True)):
        y = height - top - (i + 1) * TILE - i * gap
        for j, tile in enumerate(tiles):
            pixels = (tile.permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
            figure.figimage(pixels, left + j * (TILE + gap), y, origin="upper")
        middle = (y + TILE / 2) / height
        figure.text(0.5 * left / width, middle, name, rotation=90, ha="center", va="center", fontsize=8)
    for j, title in enumerate(titles):
        x = (left + j * (TILE + gap) + TILE / 2) / width
        figure.text(x, 1 - 0.5 * top / height, title, ha="center", va="center", fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
