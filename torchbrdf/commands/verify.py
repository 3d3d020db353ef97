"""`torchbrdf verify`: what these measured tables are, and whether they are sound."""

import argparse

from torchbrdf.command_line import BAD_INPUT
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import LIBRARY_HELP, add_strict

EXAMPLES = (
    "torchbrdf verify merl/",
    "torchbrdf verify gold.binary satin_purple.bsdf --strict",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which files."""
    parser.add_argument("paths", nargs="+", metavar="PATH", help=LIBRARY_HELP)
    add_strict(parser)


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Say which measured tables are sound, what they hold, and what is wrong with the others.

    Of a sound one: its kind, the range of f_r, the share of the cells above the horizon that were measured, and the
    most it reflects. Warns of those that reflect more than they get, or nothing, or measured few cells, and of two that
    are one measurement. Where at least half of the materials of MERL are there, says which of them are missing.
    """
    import warnings
    from dataclasses import asdict
    from pathlib import Path

    from torchbrdf.brdf import MERL_MATERIALS, verify

    found = verify(options.paths, progress=True)
    if any(Path(path).is_dir() and Path(path) not in found.folders for path in options.paths):
        findings.line(f"in {', '.join(map(str, found.folders))}:")
    findings.line(f"{len(found.sound)} sound: {', '.join(found.sound) or 'none'}")
    for name, problem in found.unsound.items():
        findings.line(f"unsound {name}: {problem}")
    for table in found.tables:
        findings.line(f"  {table}")
    is_merl = 2 * len(found.missing) <= len(MERL_MATERIALS)
    if is_merl:
        names = f": {', '.join(found.missing)}" if found.missing else ""
        findings.line(f"{len(found.missing)} of the {len(MERL_MATERIALS)} MERL materials are missing{names}")
    tables = [asdict(table) | {"remarks": table.remarks} for table in found.tables]
    findings.add(folders=found.folders, tables=tables, unsound=found.unsound, same=found.same)
    findings.add(missing=found.missing if is_merl else None)
    for table in found.tables:
        for text in table.remarks:
            warnings.warn(f"{table.name}: {text}", UserWarning, stacklevel=2)
    for one, two in found.same:
        warnings.warn(f"{one} and {two} are one measurement", UserWarning, stacklevel=2)
    if found.unsound:
        findings.failed(f"{len(found.unsound)} unsound: {', '.join(found.unsound)}")
    return BAD_INPUT if found.unsound else 0
