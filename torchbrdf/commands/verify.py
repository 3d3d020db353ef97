"""`torchbrdf verify`: what these measured tables are, and whether they are sound."""

import argparse


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which files."""
    text = "folders and files of measured tables (.binary, .fullbin, .bsdf), and folders that fit wrote"
    parser.add_argument("paths", nargs="+", metavar="PATH", help=text)


def run(options: argparse.Namespace) -> int:
    """Say which measured tables are sound, what they hold, what is wrong with the others, and what MERL has beside.

    Of a sound one: its format, the range of f_r, the share of cells that were not measured, and the most it reflects.
    """
    from pathlib import Path

    from torchbrdf.brdf import MERL_MATERIALS, library_members
    from torchbrdf.commands._inspection import inspected, one_measurement, remarks

    members = library_members(options.paths)
    folders = {member.path.parent for member in members if member.path is not None}
    if len(folders) == 1 and folders != {Path(path) for path in options.paths}:
        print(f"in {next(iter(folders))}:")
    sound, unsound = inspected(members, progress=True)
    print(f"{len(sound)} sound: {', '.join(found.name for found in sound) or 'none'}")
    for name, problem in unsound.items():
        print(f"unsound {name}: {problem}")
    for found in sound:
        print(f"  {found}")
    for line in [*remarks(sound), *one_measurement(sound)]:
        print(f"warning: {line}")
    present = {found.stem for found in sound} | {name.rsplit("/", 1)[-1] for name in unsound}
    missing = [name for name in MERL_MATERIALS if name not in present]
    print(f"{len(missing)} of the {len(MERL_MATERIALS)} MERL materials are missing", end="")
    print(f": {', '.join(missing)}" if missing else "")
    return 2 if unsound else 0
