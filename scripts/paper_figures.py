#!/usr/bin/env python3
"""Figures 2 to 5 of [CBP21] as pictures, on your own library and probes.

    python scripts/paper_figures.py 2 3 4 5 --library MERL_DIR --probes A B C --measured RGL_DIR -o OUT

Figure 2  materials photographed under A and under B, shown under C and two directional lights
Figure 3  every class's candidate and naive least squares: photographed under C, shown under A and a directional light
Figure 4  measured materials (`.bsdf`), photographed under A with a dimple, a stand, noise, a wrong exposure and a probe
          turned by one degree, shown under A, C and a directional light, with and without a mask
Figure 5  naive least squares, one class, four classes: photographed under B, shown under A and a directional light

Materials of the library are reconstructed without themselves, from photographs with noise. "paper" is penalty="paper",
"default" is penalty="auto". Pictures show B w, negative values and all, clipped to [0, 1] after an exposure and with a
gamma of 2.2, as in the paper; directional lights have exposure 1 and show a white Lambertian surface at 1.
Errors under pictures are |image - reference| / |reference| over the ball; in brackets the same of what is displayed.

OUT/paper_figure_N.png are the sheets, OUT/paper_figure_N.md their numbers. OUT/kept holds what takes long: interrupted,
the same command goes on where it stopped.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import torchbrdf as tb
from leave_one_out import open_probes
from make_targets import Material, measured_materials
from paper.figures.leave_one_out import CANDIDATES, SPIKES, SPREAD, Drawing, figure_2, figure_3, figure_5
from paper.figures.studio import Quality, Studio
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.files import writing
from torchbrdf.mitsuba_startup import load_mitsuba

SHOWN = {2: SPREAD, 3: CANDIDATES, 5: SPIKES}
DRAW = {2: figure_2, 3: figure_3, 5: figure_5}

N_PROBES = 3


def captured(folder: Path, names: Sequence[str] | None) -> list[Material]:
    """The measured materials of figure 4: those named, else those of the paper's likes that the folder holds."""
    from paper.figures.defects import CAPTURED

    there = {material.name: material for material in measured_materials(folder)}
    for name in names or ():
        if name not in there:
            raise ValueError(f"--captured: no {name}.bsdf in {folder}; there are {', '.join(there)}")
    chosen = names or [name for name in CAPTURED if name in there] or list(there)[: len(CAPTURED)]
    return [there[name] for name in chosen]


def materials_of(library: tb.MaterialLibrary, figure: int, names: Sequence[str] | None) -> list[str]:
    """The materials of a figure. Raises ValueError for one that the library does not hold."""
    chosen = list(dict.fromkeys(names or SHOWN[figure]))
    for name in chosen:
        library.position(name)
    return chosen


def run(options: argparse.Namespace) -> None:
    """Draw the figures asked for; raises ValueError or OSError for bad input before anything is rendered."""
    if find_spec("matplotlib") is None:
        raise ValueError("the figures need matplotlib: install torchbrdf[experiments]")
    figures = list(dict.fromkeys(options.figures))
    if len(options.probes) != N_PROBES:
        raise ValueError(f"--probes: give three, A B C, got {len(options.probes)}")
    quality = Quality(options.size, options.tile, options.samples, options.noise, options.seed)
    if 4 in figures and options.measured is None:
        raise ValueError("figure 4 needs measured materials: give --measured with a folder of .bsdf files")
    measured = captured(options.measured, options.captured) if 4 in figures else []
    probes = list(open_probes(options.probes).values())
    library = tb.MaterialLibrary.from_files(options.library)
    shown = {figure: materials_of(library, figure, options.materials) for figure in figures if figure != 4}
    if 4 in figures:
        load_mitsuba()
    studio = Studio(library, quality, options.output / "kept")
    studio.folder.mkdir(parents=True, exist_ok=True)
    for figure in figures:
        draw: Callable[[], Drawing]
        if figure == 4:
            from paper.figures.defects import figure_4

            draw = partial(figure_4, studio, probes, measured)
        else:
            draw = partial(DRAW[figure], studio, probes, shown[figure])
        write(options.output, figure, draw)


def write(folder: Path, figure: int, draw: Callable[[], Drawing]) -> None:
    """Draw a figure, write it and print its numbers."""
    sheet, numbers = draw()
    path = folder / f"paper_figure_{figure}.png"
    sheet.write(path)
    with writing(path.with_suffix(".md")) as temporary:
        temporary.write_text(numbers + "\n")
    print(f"\n{path}\n\n{numbers}\n", flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("figures", nargs="+", type=int, choices=(2, 3, 4, 5), help="which figures")
    parser.add_argument("--library", required=True, help="folder of MERL *.binary tables, or `default`")
    parser.add_argument("--probes", nargs="+", required=True, metavar="FILE", help="A B C: lat-long .exr or .hdr files")
    parser.add_argument("--measured", type=Path, metavar="FOLDER", help="of .bsdf files, for figure 4")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the figures")
    parser.add_argument("--materials", nargs="+", metavar="NAME", help="of the library, instead of each figure's own")
    parser.add_argument("--captured", nargs="+", metavar="NAME", help="measured materials of figure 4")
    parser.add_argument("--size", type=int, default=64, help="pixels along a side of the photographs")
    parser.add_argument("--tile", type=int, default=128, help="pixels along a side of the pictures")
    parser.add_argument("--noise", type=float, default=1.0, help="of the library's photographs, in %% of every pixel")
    parser.add_argument(
        "--samples", type=int, help="a pixel: sampled transport instead of the harmonic one, quicker to start and noisy"
    )
    parser.add_argument("--seed", type=int, default=0)
    return exit_status("paper_figures", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
