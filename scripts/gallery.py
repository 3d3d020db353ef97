#!/usr/bin/env python3
"""The gallery: every material of a library as a ball, and what one photograph makes of it in a library without it.

    python scripts/gallery.py -o OUT --document docs/gallery.md

Each material is photographed under the embedded light probe, by the sampled transport, with noise; recovered from the
library without it and its family, whose classes are fitted anew, with basis images of the harmonic transport; and
shown beside the truth under a studio light that it was not photographed under. Errors are |shown - true| / |true| of
these two pictures, whose pixels below zero are black.

OUT/MATERIAL.webp are the pictures, OUT/rows what is told of each: interrupted, the same command goes on where it
stopped. --document replaces the results of a page, and the pictures in figures/gallery beside it.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from leave_one_out import check_settings
from paper.figures.studio import stored
from showcase.neighbours import METRIC, distances, nearest
from showcase.page import FOLDER, OVERVIEW, TITLES, Row, body, ordered, picture_name
from showcase.studio import studio
from showcase.tiles import SUPERSAMPLING, ball, side_by_side, write_overview, write_picture
from torchbrdf.brdf import columns_of, delta_e_2000
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.experiments import (
    by_relatives,
    check_document,
    noisy_observations,
    relatives,
    replace_results,
    without_relatives,
)
from torchbrdf.files import writing, writing_folder
from torchbrdf.images import relative_rms

EXPOSURE = 0.6
"""Of pictures: a white Lambertian ball is nearly white where the light is brightest."""

BLOWN_OUT = 0.15
"""Share of a ball's pixels up to which they may be clipped; beyond, the exposure is halved."""

NEIGHBOURS = 3


@dataclass(frozen=True)
class Gallery:
    """What all materials share.

    photographs  material -> (3, N, N) under the embedded probe, without noise
    basis        images of the whole library under it, made otherwise than the photographs
    shown        how balls are shown under the studio light; pictures: weights (K, n, 3) -> their (K, 3, 2 T, 2 T)
    classes      of the whole library;  far (m, m) its `distances`
    """

    library: tb.MaterialLibrary
    photographs: dict[str, Tensor]
    basis: tb.BasisImages
    shown: tb.SphereView
    pictures: Callable[[Tensor], Tensor]
    classes: tb.MaterialClasses
    far: Tensor
    noise: float
    seed: int

    @classmethod
    def of(cls, library: tb.MaterialLibrary, options: argparse.Namespace) -> "Gallery":
        """Render what all materials share."""
        room, view = tb.LightProbe.default(), tb.SphereView(options.size)
        backend, samples, seed = "sampled" if options.samples else "harmonic", options.samples, options.seed
        basis = tb.render_basis(library, room, view, backend, samples, seed, progress=True)

        def shared() -> dict[str, Tensor]:
            other = tb.render_basis(library, room, view, "sampled", samples, seed + 1, progress=True)
            photographs = torch.stack([other.image(name) for name in library.names])
            return {"photographs": photographs, "far": distances(library)}

        kept = stored(options.output / "shared.safetensors", settings_of(library, options), shared)
        shown = tb.SphereView(SUPERSAMPLING * options.tile)
        return cls(
            library,
            dict(zip(library.names, kept["photographs"], strict=True)),
            basis,
            shown,
            _pictures(library, shown, samples),
            tb.MaterialClasses.fit(library, options.classes),
            kept["far"],
            options.noise,
            seed,
        )

    def recovered(self, materials: Sequence[str]) -> tuple[Tensor, Tensor]:
        """Of materials of one family: weights (b, n, 3) over the whole library, and how far the fits are off (b)."""
        less = without_relatives(self.library, materials[0])
        classes = tb.MaterialClasses.fit(less, self.classes.n_classes)
        photographs = torch.stack([self._photograph(material) for material in materials])
        found = tb.BRDFEstimator(self.basis.subset(less.names), classes)(photographs)
        weights = torch.zeros(len(materials), self.library.n, 3)
        weights[:, columns_of([self.library.position(name) for name in less.names])] = found.weights.float()
        return weights, found.relative_error

    def _photograph(self, material: str) -> Tensor:
        image = self.photographs[material]
        return noisy_observations(image, [self.noise], f"{self.seed} {material}")[0].float()

    def shown_pair(self, material: str, weights: Tensor) -> tuple[Tensor, Tensor]:
        """(3, 2 T, 2 T) radiance of a material, and of what was recovered with weights (n, 3)."""
        itself = torch.zeros_like(weights)
        itself[columns_of([self.library.position(material)])] = torch.eye(3)
        true, shown = self.pictures(torch.stack([itself, weights])).clamp_min(0)
        return true, shown

    def row(self, material: str, fitted: float, true: Tensor, shown: Tensor) -> Row:
        """What is told of a material whose picture should be `true` and is `shown`."""
        names, position = self.library.names, self.library.position(material)
        family = tuple(name for name in relatives(material, names) if name != material)
        near = nearest(self.far, position, len(names))
        exposure = exposure_for(true[:, self.shown.mask[0]])
        labels = self.classes.labels[3 * position : 3 * position + 3]
        return Row(
            material,
            int(torch.bincount(labels).argmax()),
            family,
            tuple((names[i], far) for i, far in near[:NEIGHBOURS]),
            next(far for i, far in near if names[i] not in family),
            fitted,
            relative_rms(shown, true, self.shown.mask),
            float(delta_e_2000(shown, true, exposure)[self.shown.mask[0]].mean()),
            exposure,
        )


def exposure_for(radiance: Tensor) -> float:
    """EXPOSURE, halved until it clips no more than BLOWN_OUT of the pixels (3, P)."""
    exposure = EXPOSURE
    while float((exposure * radiance.amax(0) > 1).double().mean()) > BLOWN_OUT:
        exposure /= 2
    return exposure


def _pictures(library: tb.MaterialLibrary, shown: tb.SphereView, samples: int | None) -> Callable[[Tensor], Tensor]:
    """Weights (K, n, 3) -> radiance (K, 3, 2 T, 2 T) under the studio light, by the transport asked for."""
    if samples is None:
        return tb.HarmonicBasis(library, studio(), shown).images_of
    return tb.render_basis(library, studio(), shown, "sampled", samples, progress=True).render


def settings_of(library: tb.MaterialLibrary, options: argparse.Namespace) -> dict[str, object]:
    """What the pictures depend on."""
    chosen = ("size", "samples", "noise", "tile", "classes", "seed")
    return {
        "library": library.source,
        "names": list(library.names),
        "light": studio().fingerprint,
        "exposure": EXPOSURE,
        "metric": METRIC,
        "version": tb.__version__,
        **{key: getattr(options, key) for key in chosen},
    }


def read_row(path: Path) -> Row:
    """What `write_row` wrote."""
    stored = json.loads(path.read_text())
    near = tuple((name, far) for name, far in stored.pop("neighbours"))
    return Row(**{**stored, "left_out": tuple(stored["left_out"]), "neighbours": near})


def write_row(path: Path, row: Row) -> None:
    """Keep what is told of a material."""
    with writing(path) as temporary:
        temporary.write_text(json.dumps(asdict(row), indent=1))


def run(options: argparse.Namespace) -> None:
    """Make what is missing, then the page; raises ValueError or OSError for bad input before anything is rendered."""
    if options.size < 8 or options.tile < 8:
        raise ValueError(f"--size and --tile must be at least 8, got {options.size} and {options.tile}")
    if not 0 <= options.noise < float("inf"):
        raise ValueError(f"--noise must be a percentage of at least 0, got {options.noise}")
    if options.samples is not None and options.samples < 2:
        raise ValueError(f"--samples must be at least 2, got {options.samples}")
    if options.document is not None:
        check_document(options.document)
    library = tb.MaterialLibrary.from_files(options.library)
    rows: Path = options.output / "rows"
    rows.mkdir(parents=True, exist_ok=True)
    check_settings(options.output / "settings.json", settings_of(library, options))
    paths = {name: rows / f"{picture_name(name)}.json" for name in library.names}
    missing = [name for name in library.names if not paths[name].exists()]
    if missing:
        gallery = Gallery.of(library, options)
        with tqdm(total=len(library), initial=len(library) - len(missing), desc="materials") as bar:
            for materials in by_relatives(missing, library.names).values():
                weights, fitted = gallery.recovered(materials)
                for material, found, share in zip(materials, weights, fitted.tolist(), strict=True):
                    true, shown = gallery.shown_pair(material, found)
                    row = gallery.row(material, share, true, shown)
                    pair = side_by_side([ball(image, row.exposure) for image in (true, shown)])
                    write_picture(options.output / f"{picture_name(material)}.webp", pair)
                    write_row(paths[material], row)
                    bar.update()
    told = [read_row(path) for path in paths.values()]
    worst = max(told, key=lambda row: row.error)
    mean = sum(row.error for row in told) / len(told)
    print(f"{len(told)} materials: error {mean:.2%} in the mean, {worst.error:.2%} at worst ({worst.material})")
    if options.document is not None:
        write_page(options.document, options.output, told, TITLES if options.library == "default" else ())


def write_page(document: Path, pictures: Path, rows: Sequence[Row], titles: Sequence[str]) -> None:
    """Replace the results of a page, and the pictures beside it."""
    files = [pictures / f"{picture_name(row.material)}.webp" for row in ordered(rows)]
    folder = document.parent / FOLDER
    old = [path.name for path in folder.glob("*.webp")]
    with writing_folder(folder, obsolete=old) as temporary:
        for path in files:
            shutil.copyfile(path, temporary / path.name)
        write_overview(temporary / f"{OVERVIEW}.webp", files)
    replace_results(document, body(rows, titles))
    print(f"wrote {document} and {len(files) + 1} pictures in {folder}")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", default="default", help="folder of MERL *.binary tables; default: the embedded")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of pictures and what is told of them")
    parser.add_argument("--document", type=Path, metavar="PAGE", help="Markdown page whose results are replaced")
    parser.add_argument("--size", type=int, default=64, help="pixels along a side of the photographs; default: 64")
    parser.add_argument("--tile", type=int, default=192, help="pixels along a side of a picture; default: 192")
    parser.add_argument("--noise", type=float, default=1.0, help="of the photographs, in %% of every pixel; default: 1")
    parser.add_argument("--classes", type=int, default=4, help="default: 4")
    parser.add_argument(
        "--samples", type=int, help="a pixel: sampled transport instead of the harmonic one, quicker to start and noisy"
    )
    parser.add_argument("--seed", type=int, default=0)
    return exit_status("gallery", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
