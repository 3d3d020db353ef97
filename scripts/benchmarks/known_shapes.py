"""Claim: a BRDF is recovered from a photograph of a known shape other than a sphere, too [CBP21, fig. 6].

    python scripts/benchmarks/known_shapes.py --library MERL_DIR [--probe venice.exr] [--parts figure cost normals]

figure   five shapes: errors on the photograph and under novel light, and docs/figures/known_shapes.png
cost     what it costs to ignore shadows or interreflections, measured against path tracing by Mitsuba
normals  shapes that show few normals, and docs/figures/known_shapes_normals.png

Every material is recovered with a library without it, from a photograph with noise. Errors are |a - b| / |b| over
all channels and pixels under the mask; "novel light" is a sphere of the recovered BRDF under other probes, mean.
Photographs have random numbers of their own.
"""

import argparse
import statistics
import time
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from known_shapes_cost import compare_light
from known_shapes_report import (
    LIGHTS,
    display_size,
    lit_spheres,
    observations,
    print_judgements,
    print_table,
    probe_tile,
    write_grid,
    write_scatter,
)
from known_shapes_scenes import PENALTIES, SHAPES, Judge, Judgement, Photographs, open_view, photograph
from torchbrdf.command_line import Parser
from torchbrdf.experiments import SHARED, few_normals, mesh_view
from torchbrdf.rendering import render_tables
from torchbrdf.transport import DEFAULT_SAMPLES
from torchbrdf.transport.basis_images import FEWEST_NORMALS

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures"

MATERIALS = (
    "white-diffuse-bball",
    "pink-fabric",
    "yellow-plastic",
    "gold-metallic-paint2",
    "specular-blue-phenolic",
    "brass",
)
"""From diffuse to mirror-like."""

SHOWN = ("pink-fabric", "gold-metallic-paint2", "brass")


def main() -> None:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, required=True, help="folder of MERL *.binary tables")
    parser.add_argument("--shapes", type=Path, default=SHARED / "shapes", help="folder of the meshes")
    parser.add_argument("--probe", type=Path, default=SHARED / "probes" / "venice.exr", help="light of the photographs")
    novel = [SHARED / "probes" / name for name in ("grace.hdr", "uffizi.hdr", "ennis.hdr")]
    parser.add_argument("--novel", type=Path, nargs="+", default=novel, help="light probes of the comparison")
    parser.add_argument("--materials", nargs="+", default=MATERIALS)
    parser.add_argument("--size", type=int, default=64, help="pixels along a side of a photograph")
    parser.add_argument("--noise", type=float, default=1.0, help="of the photographs, in %% of every pixel")
    parts = ("figure", "cost", "normals")
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts)
    parser.add_argument("-o", "--output", type=Path, default=FIGURES, help="folder of the pictures")
    options = parser.parse_args()
    unknown = [path for path in (options.probe, *options.novel) if not path.is_file()]
    if unknown:
        parser.error(f"no light probe {unknown[0]}")

    library = tb.MaterialLibrary.from_merl(options.library)
    probe = tb.LightProbe.open(options.probe, rows="poles")
    others = {path.stem: tb.LightProbe.open(path, rows="poles") for path in options.novel}
    judge = Judge(library, options.materials, others, options.size)
    start = time.monotonic()
    if {"figure", "cost"} & set(options.parts):
        views = {shape: open_view(shape, options.shapes, options.size) for shape in SHAPES}
        bases = {shape: tb.render_basis(library, probe, view) for shape, view in tqdm(views.items(), "basis images")}
        clean = {shape: photograph(judge.tables, probe, view) for shape, view in tqdm(views.items(), "photographs")}
        if "figure" in options.parts:
            compare_shapes(judge, probe, views, bases, clean, options)
        if "cost" in options.parts:
            compare_light(judge, probe, views, bases, clean, options.shapes, options.noise)
    if "normals" in options.parts:
        compare_normals(judge, probe, options)
    print(f"\n{time.monotonic() - start:.0f} s")


def compare_shapes(
    judge: Judge,
    probe: tb.LightProbe,
    views: Mapping[str, tb.View],
    bases: Mapping[str, tb.BasisImages],
    clean: Mapping[str, Photographs],
    options: argparse.Namespace,
) -> None:
    """Errors by shape and material; Mitsuba's basis images beside ours; the picture."""
    errors: dict[str, dict[str, dict[str, Judgement]]] = {name: {} for name in PENALTIES}
    recovered: dict[tuple[str, str], tb.MerlTable] = {}
    shown = [material for material in SHOWN if material in judge.materials]
    for shape, basis in bases.items():
        for name, penalty in PENALTIES.items():
            results = judge.fit(basis, clean[shape].images, options.noise, penalty)
            errors[name][shape] = judge.judge(results)
            if name == "default":
                for material in shown:
                    recovered[shape, material] = results[material].brdf(judge.library.without(material))
    for name, by_shape in errors.items():
        print(f"\n### {name} penalty: observation / novel light [%]\n")
        print_judgements(judge.materials, by_shape)
    print("\n### Monte Carlo noise of the photographs [%]\n")
    noise = [(shape, *(f"{100 * value:.2f}" for value in images.noise.tolist())) for shape, images in clean.items()]
    print_table(("shape", *judge.materials), noise)

    if "bunny" in views:
        compare_backends(judge, probe, views["bunny"], bases["bunny"], clean["bunny"].images, options.noise)
    if recovered:
        whole = judge.table_errors(list(recovered.values()), [material for _, material in recovered])
        print("\n### novel light, the whole tables of the picture [%]\n")
        found = dict(zip(recovered, (100 * whole).tolist(), strict=True))
        print_table(("shape", *shown), [(s, *(f"{found[s, m]:.2f}" for m in shown)) for s in bases])
        write_figure(judge, probe, views, recovered, options)


def compare_backends(
    judge: Judge, probe: tb.LightProbe, view: tb.View, ours: tb.BasisImages, images: Tensor, noise: float
) -> None:
    """The same photographs fitted with basis images from Mitsuba."""
    baked = tb.render_basis(judge.library, probe, view, backend="mitsuba", samples=4 * DEFAULT_SAMPLES, seed=7)
    difference = torch.linalg.vector_norm((baked.packed - ours.packed).flatten(1), dim=1)
    relative = 100 * difference / torch.linalg.vector_norm(baked.packed.flatten(1), dim=1)
    estimated = torch.zeros(baked.n) if baked.relative_errors is None else baked.relative_errors
    print(
        f"\nbunny, basis images from Mitsuba: differ by {float(relative.median()):.2f} % (median of {baked.n}), "
        f"{float(relative.max()):.2f} % (worst); Mitsuba's own estimate of its error: "
        f"{100 * float(estimated.median()):.2f} % and {100 * float(estimated.max()):.2f} %\n"
    )
    backends = {"sampled": ours, "mitsuba": baked}
    rows = {name: judge.judge(judge.fit(basis, images, noise)) for name, basis in backends.items()}
    print_judgements(judge.materials, rows, "backend")


def compare_normals(judge: Judge, probe: tb.LightProbe, options: argparse.Namespace) -> None:
    """Error against the share of a sphere's normals."""
    coverage, by_shape = {}, {}
    for shape, (mesh, camera) in tqdm(few_normals().items(), "few normals"):
        view = mesh_view(mesh, camera, options.size)
        basis = tb.render_basis(judge.library, probe, view)
        coverage[shape] = basis.normal_coverage
        images = render_tables(judge.tables, probe, view, seed=1000)
        by_shape[shape] = {
            name: judge.judge(judge.fit(basis, images, options.noise, penalty)) for name, penalty in PENALTIES.items()
        }
    means = {}
    rows = []
    for shape in sorted(coverage, key=coverage.__getitem__):
        row = [shape, f"{coverage[shape]:.3f}"]
        for judgements in by_shape[shape].values():
            novel = [100 * judgement.novel for judgement in judgements.values()]
            observation = [100 * judgement.observation for judgement in judgements.values()]
            row += [f"{statistics.mean(observation):.2f}", f"{statistics.mean(novel):.2f}", f"{max(novel):.2f}"]
        means[shape] = statistics.mean(100 * judgement.novel for judgement in by_shape[shape]["default"].values())
        rows.append(row)
    print("\n### Shapes that show few normals [%]\n")
    columns = [f"{name}: {what}" for name in PENALTIES for what in ("observation", "novel, mean", "novel, worst")]
    print_table(("shape", "coverage", *columns), rows)
    write_scatter(options.output / "known_shapes_normals.png", coverage, means, FEWEST_NORMALS)


def write_figure(
    judge: Judge,
    probe: tb.LightProbe,
    views: Mapping[str, tb.View],
    recovered: Mapping[tuple[str, str], tb.MerlTable],
    options: argparse.Namespace,
) -> None:
    """Figure 6: observations above, and recovered BRDFs on spheres under directional light."""
    shown = [material for material in SHOWN if material in judge.materials]
    truths = [judge.tables[judge.materials.index(material)] for material in shown]
    large = [open_view(shape, options.shapes, display_size()) for shape in views]
    observed = observations(truths, probe, large)
    blocks: dict[str, dict[str, list[Tensor | None]]] = {}
    for i, material in enumerate(shown):
        rows: dict[str, list[Tensor | None]] = {f"observed, {options.probe.stem}": [*observed[i], probe_tile(probe)]}
        for angle in LIGHTS:
            tables = [recovered[shape, material] for shape in views]
            rows[f"recovered, light at {angle}°"] = [*lit_spheres([*tables, truths[i]], angle)]
        blocks[material] = rows
    write_grid(options.output / "known_shapes.png", (*views, "light / truth"), blocks)


if __name__ == "__main__":
    main()
