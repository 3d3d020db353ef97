"""What `fit` and `demo` write of a result into a folder."""

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from torchbrdf.brdf import RESULT, RESULT_STD, TABLE_SUFFIXES, MerlTable, above_horizon
from torchbrdf.commands import _alignment
from torchbrdf.commands._lit_sight import LitSight
from torchbrdf.commands._options import inputs_of
from torchbrdf.commands._reconstruction import Fit, relative_std, result_record, weights_record
from torchbrdf.commands._said import say_doubts
from torchbrdf.commands._weights import WEIGHTS, write_weights
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, write_image
from torchbrdf.report import Doubt, Grade, Scene, doubts_without_pictures, write_report

_ALIGNED = ("alignment.json", "aligned_probe.exr")
_REPORT = "report.html"


def products(options: argparse.Namespace, names: Sequence[str] = ()) -> list[str]:
    """The files that `fit` writes.

    names  of several photographs of one material, each of which has a part of its own
    """
    def each(*files: str) -> list[str]:
        return [ended(file, name) for file in files for name in names] or list(files)

    own = each("fitted.exr"), [] if options.no_report else each(_REPORT)
    first = [RESULT_STD] if options.uncertainty else [], each(*_ALIGNED) if options.align else []
    return [*chain(*first), RESULT, WEIGHTS, *chain(*own)]


def ended(file: str, name: str | None) -> str:
    """The file of one of several photographs."""
    return file if name is None else file.replace(".", f"_{name}.")


def written(
    photograph: Path,
    folder: Path,
    files: Sequence[str],
    said: Mapping[str, Sequence[str]],
    fitted: Fit | None,
    name: str | None = None,
    grade: Grade | None = None,
) -> dict[str, Any]:
    """What a script is told of a photograph whose results are in a folder, and is found there.

    said    its warnings and notes, see `in_record`
    fitted  None where it was finished before
    name    of one of several photographs of a material
    grade   that the report gives; None without a report
    """
    record = json.loads((folder / WEIGHTS).read_text())
    alignment = ended(_ALIGNED[0], name)
    return {
        "photograph": photograph,
        "outcome": "kept" if fitted is None else "written",
        "error": None,
        "folder": folder,
        **result_record(record),
        "grade": None if grade is None else grade.word,
        "relative_std": None if fitted is None else relative_std(fitted),
        "alignment": json.loads((folder / alignment).read_text()) if alignment in files else None,
        "files": [folder / file for file in files],
        **said,
    }


def failure(photograph: Path, error: str) -> dict[str, Any]:
    """What a script is told of one without results."""
    return {"photograph": photograph, "outcome": "failed", "error": error}


def obsolete(folder: Path) -> list[str]:
    """The files of an earlier run in a folder: those that `fit` may write, and those that weights.json tells of."""
    found = [RESULT, WEIGHTS, RESULT_STD, *_ALIGNED, "fitted.exr", _REPORT]
    try:
        listed = json.loads((folder / WEIGHTS).read_text())["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return found
    return [*found, *(name for name in listed if isinstance(name, str) and Path(name).name == name)]


def check_inputs_stay(options: argparse.Namespace, folders: Iterable[Path], names: Sequence[str] = ()) -> None:
    """Raise ValueError where an input is a file that a result in one of some folders replaces, or that goes with an
    earlier one.

    names  as of `products`
    """
    given = set(map(_identity, inputs_of(options)))
    for folder in filter(Path.is_dir, folders):
        for file in map(folder.joinpath, {*products(options, names), *obsolete(folder)}):
            known = {file, folder} if file.suffix in TABLE_SUFFIXES else {file}
            if file.is_file() and not given.isdisjoint(map(_identity, known)):
                text = "an input, which a result in this folder replaces or removes; give another -o"
                raise ValueError(f"{file}: {text}")


def _identity(path: Path) -> tuple[int, int]:
    """What two names of one file share, as of `Path.samefile`."""
    found = path.stat()
    return found.st_dev, found.st_ino


def write_results(
    folder: Path,
    fitted: Fit,
    settings: Mapping[str, str],
    primaries: ColourSpace = DEFAULT_SPACE,
    scene: Scene | None = None,
) -> None:
    """Write brdf.binary, weights.json, fitted.exr and report.html into a folder; says all that the report does."""
    write_table(folder, fitted, uncertainty=False)
    write_image(folder / "fitted.exr", fitted.image, primaries=primaries)
    write_page(folder / _REPORT, fitted, settings, scene, primaries=primaries)
    write_weights(folder, weights_record(fitted) | {"primaries": primaries})


def write_table(folder: Path, fitted: Fit, uncertainty: bool) -> None:
    """Write brdf.binary, and where that is asked for brdf_std.binary."""
    fitted.table.save(folder / RESULT)
    if uncertainty:
        deviation = fitted.result.brdf_std(fitted.subject.library).double()
        MerlTable(deviation, above_horizon(), "standard deviation").save(folder / RESULT_STD)


def write_views(
    folder: Path, lit: LitSight, fitted: Fit, options: argparse.Namespace, name: str | None = None
) -> Grade | None:
    """Write what belongs to one photograph: fitted.exr, what an alignment found, report.html unless that is unwanted.

    name  of one of several photographs of a material
    Says all that the report does, and returns its grade.
    """
    if lit.found is not None:
        record, probe = (folder / ended(file, name) for file in _ALIGNED)
        _alignment.write(record, probe, lit.found, options.primaries)
    write_image(folder / ended("fitted.exr", name), fitted.image, primaries=options.primaries)
    if options.no_report:
        return None
    report, settings = folder / ended(_REPORT, name), lit.settings(options)
    return write_page(report, fitted, settings, lit.scene, lit.doubts, options.primaries)


def write_page(
    path: Path,
    fitted: Fit,
    settings: Mapping[str, str],
    scene: Scene | None,
    known: Sequence[Doubt] = (),
    primaries: ColourSpace = DEFAULT_SPACE,
) -> Grade:
    """Write report.html, and say all that it warns of but what is known of the capture and was said; its grade."""
    description = dict(settings) | {
        "penalty": str(fitted.estimator.penalty),
        "constraint": str(fitted.estimator.constraint or "none"),
        "outliers": "left out" if fitted.estimator.robust else "used",
        "classes": f"{fitted.classes.sizes} basis BRDFs",
    }
    observability = fitted.setting.observability
    constraint = fitted.estimator.constraint
    tried = [
        *(["--align"] if "alignment" in settings else []),
        *(["--robust"] if fitted.estimator.robust else []),
        *([f"--constraint {constraint}"] if constraint else []),
    ]
    verdict = write_report(
        path,
        fitted.subject,
        description,
        observability=observability,
        scene=scene,
        tried=tried,
        known=known,
        primaries=primaries,
    )
    say_doubts(verdict.doubts)
    return verdict.grade


def say_doubts_of(fitted: Fit) -> None:
    """Say what the report would, as far as no picture is needed for it."""
    say_doubts(doubts_without_pictures(fitted.result, fitted.subject.basis, fitted.table))
