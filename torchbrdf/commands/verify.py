"""`torchbrdf verify`: are these files sound MERL tables?"""

import argparse
from pathlib import Path


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which files."""
    parser.add_argument("directory", type=Path, help="folder of MERL *.binary files")


def run(options: argparse.Namespace) -> int:
    """Say which files of a folder are sound MERL tables, what is wrong with the others, and what is missing."""
    from torchbrdf.brdf import MERL_MATERIALS, verify

    report = verify(options.directory, progress=True)
    if report.folder != options.directory:
        print(f"in {report.folder}:")
    print(f"{len(report.sound)} sound: {', '.join(report.sound) or 'none'}")
    for name, problem in report.unsound.items():
        print(f"unsound {name}: {problem}")
    print(f"{len(report.missing)} of the {len(MERL_MATERIALS)} MERL materials are missing", end="")
    print(f": {', '.join(report.missing)}" if report.missing else "")
    return 2 if report.unsound else 0
