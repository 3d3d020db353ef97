"""What known_shapes.py --parts cost does: photographs with interreflections, path traced by Mitsuba."""

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from known_shapes_report import print_judgements, print_table
from known_shapes_scenes import PENALTIES, Judge, Judgement, Photographs, open_view
from torchbrdf.images import relative_rms
from torchbrdf.mitsuba_backend import MitsubaScene

PATH_SAMPLES = {"brass": 2048}
"""Samples a pixel of the path tracer, for materials that need more than DEFAULT_PATH_SAMPLES."""

DEFAULT_PATH_SAMPLES = 1024
MAX_DEPTH = 8
"""Of paths: light that is reflected up to seven times."""

CASES = {
    "A": "photograph without interreflections, basis with shadows: nothing ignored",
    "B": "photograph with interreflections, basis with shadows: interreflections ignored",
    "C": "photograph with interreflections, basis without shadows: both ignored",
    "D": "photograph without interreflections, basis without shadows: shadows ignored",
}


def compare_light(
    judge: Judge,
    probe: tb.LightProbe,
    views: Mapping[str, tb.View],
    bases: Mapping[str, tb.BasisImages],
    clean: Mapping[str, Photographs],
    meshes: Path,
    noise: float,
) -> None:
    """What ignoring interreflections and shadows costs; a sphere, which is convex, knows neither."""
    shapes = [shape for shape in views if shape != "sphere"]
    print(f"\n### Depth of the paths: relative difference to {2 * MAX_DEPTH} [%]\n")
    print_depths(judge, probe, views["Buddha"])
    cases: dict[str, dict[str, dict[str, dict[str, Judgement]]]]
    cases = {name: {case: {} for case in CASES} for name in PENALTIES}
    share: dict[str, list[float]] = {}
    shadow: dict[str, list[float]] = {}
    checks = []
    for shape in tqdm(shapes, "path tracing"):
        direct = clean[shape]
        reflected, single = interreflections(judge, probe, views[shape])
        full = Photographs(direct.halves + reflected)
        checks += [(shape, *row) for row in checked(judge.materials, direct, full, single)]
        view = open_view(shape, meshes, views[shape].size[0], shadows=False)
        unshadowed = tb.render_basis(judge.library, probe, view)
        for case, photographs, basis in (
            ("A", direct, bases[shape]),
            ("B", full, bases[shape]),
            ("C", full, unshadowed),
            ("D", direct, unshadowed),
        ):
            for name, penalty in PENALTIES.items():
                cases[name][case][shape] = judge.judge(judge.fit(basis, photographs.images, noise, penalty))
        share[shape] = [relative_rms(*pair, view.mask) for pair in zip(direct.images, full.images, strict=True)]
        lit = [unshadowed.image(material) for material in judge.materials]
        shadow[shape] = [relative_rms(*pair, view.mask) for pair in zip(lit, direct.images, strict=True)]
    print("\n### The photographs: noise [%], and Mitsuba's direct light against ours\n")
    header = ("shape", "material", "noise, direct", "noise, with interreflections", "Mitsuba / ours", "noise of that")
    print_table(header, checks)
    for title, values in (("leaving out interreflections", share), ("leaving out shadows", shadow)):
        print(f"\n### What {title} changes in the image [%]\n")
        with_means = {shape: [*row, statistics.mean(row)] for shape, row in values.items()}
        rows = [(shape, *(f"{100 * value:.1f}" for value in row)) for shape, row in with_means.items()]
        print_table(("shape", *judge.materials, "mean"), rows)
    for case, title in CASES.items():
        print(f"\n### {case}: {title}; observation / novel light [%]\n")
        print_judgements(judge.materials, cases["default"][case])
    for name, by_case in cases.items():
        print(f"\n### {name} penalty, novel light, mean of the materials [%]\n")
        rows = []
        for case, by_shape in by_case.items():
            means = [statistics.mean(found.novel for found in by_shape[shape].values()) for shape in shapes]
            rows.append((case, *(f"{100 * value:.1f}" for value in (*means, statistics.mean(means)))))
        print_table(("", *shapes, "mean"), rows)


def interreflections(judge: Judge, probe: tb.LightProbe, view: tb.View) -> tuple[Tensor, Tensor]:
    """Light that is reflected more than once, by Mitsuba: (2, m, 3, H, W) in two halves; and that reflected once.

    Paths of MAX_DEPTH less paths of one reflection with the same random numbers: the first reflection cancels
    exactly, and with it most of the noise.
    """
    deep = MitsubaScene(view, probe, judge.tables[0], {"type": "path", "max_depth": MAX_DEPTH})
    shallow = MitsubaScene(view, probe, judge.tables[0], {"type": "path", "max_depth": 2})
    size = (2, len(judge.materials), 3, *view.size)
    reflected, single = torch.zeros(size), torch.zeros(size)
    for i, (material, table) in enumerate(zip(judge.materials, judge.tables, strict=True)):
        deep.set_table(table)
        shallow.set_table(table)
        samples = PATH_SAMPLES.get(material, DEFAULT_PATH_SAMPLES) // 2
        for half in range(2):
            single[half, i] = shallow.render(samples, seed=half)
            reflected[half, i] = deep.render(samples, seed=half) - single[half, i]
    return reflected, single


def checked(
    materials: Sequence[str], direct: Photographs, full: Photographs, single: Tensor
) -> list[tuple[str, ...]]:
    """For each material: noise of both photographs, and all light of Mitsuba's direct image over that of ours."""
    rows = []
    for i, material in enumerate(materials):
        ratios = [float(single[half, i].sum() / direct.images[i].sum()) for half in range(2)]
        ratio, spread = statistics.mean(ratios), abs(ratios[0] - ratios[1]) / 2
        noise = (f"{100 * float(images.noise[i]):.2f}" for images in (direct, full))
        rows.append((material, *noise, f"{ratio:.4f}", f"{spread:.4f}"))
    return rows


def print_depths(judge: Judge, probe: tb.LightProbe, view: tb.View) -> None:
    """How far paths must go, with equal random numbers."""
    depths = (2, 3, 4, 6, MAX_DEPTH)
    rows = []
    for material in (judge.materials[0], judge.materials[-1]):
        scenes = {
            depth: MitsubaScene(
                view, probe, judge.library.table(material), {"type": "path", "max_depth": depth, "rr_depth": 99}
            )
            for depth in (*depths, 2 * MAX_DEPTH)
        }
        images = {depth: scene.render(256) for depth, scene in scenes.items()}
        deepest = images.pop(2 * MAX_DEPTH)
        rows.append((material, *(f"{100 * relative_rms(image, deepest, view.mask):.3f}" for image in images.values())))
    print_table(("Buddha", *map(str, depths)), rows)
