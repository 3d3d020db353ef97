"""A directory of measured tables, and the names of the 100 materials of MERL [MPBM03]."""

import os
from collections import Counter
from pathlib import Path

from torchbrdf.brdf.settings import RESULT, RESULT_STD, TABLE_SUFFIXES

MERL_MATERIALS = tuple(
    """
    alum-bronze alumina-oxide aluminium aventurnine beige-fabric black-fabric black-obsidian black-oxidized-steel
    black-phenolic black-soft-plastic blue-acrylic blue-fabric blue-metallic-paint blue-metallic-paint2 blue-rubber
    brass cherry-235 chrome chrome-steel colonial-maple-223 color-changing-paint1 color-changing-paint2
    color-changing-paint3 dark-blue-paint dark-red-paint dark-specular-fabric delrin fruitwood-241 gold-metallic-paint
    gold-metallic-paint2 gold-metallic-paint3 gold-paint gray-plastic grease-covered-steel green-acrylic green-fabric
    green-latex green-metallic-paint green-metallic-paint2 green-plastic hematite ipswich-pine-221 light-brown-fabric
    light-red-paint maroon-plastic natural-209 neoprene-rubber nickel nylon orange-paint pearl-paint pickled-oak-260
    pink-fabric pink-fabric2 pink-felt pink-jasper pink-plastic polyethylene polyurethane-foam pure-rubber purple-paint
    pvc red-fabric red-fabric2 red-metallic-paint red-phenolic red-plastic red-specular-plastic silicon-nitrade
    silver-metallic-paint silver-metallic-paint2 silver-paint special-walnut-224 specular-black-phenolic
    specular-blue-phenolic specular-green-phenolic specular-maroon-phenolic specular-orange-phenolic
    specular-red-phenolic specular-violet-phenolic specular-white-phenolic specular-yellow-phenolic ss440 steel teflon
    tungsten-carbide two-layer-gold two-layer-silver violet-acrylic violet-rubber white-acrylic white-diffuse-bball
    white-fabric white-fabric2 white-marble white-paint yellow-matte-plastic yellow-paint yellow-phenolic
    yellow-plastic
    """.split()
)
"""The 100 materials of the MERL database, as their files are named."""


_MOST_KINDS = 4


def table_paths(directory: str | os.PathLike[str]) -> list[Path]:
    """The tables of a directory, sorted by name: its `.binary`, `.fullbin` and `.bsdf` files, in capitals or not.

    Where it has none, those of the one folder in it that has, or the tables of all folders in it that `torchbrdf fit`
    wrote. Names that begin with a dot are of no table: macOS leaves such a file beside each; brdf_std.binary beside
    brdf.binary is none either. Raises FileNotFoundError, NotADirectoryError or PermissionError; ValueError where there
    is no table, several folders have some, or two are of one name.
    """
    directory = Path(directory)
    if not directory.is_dir():
        if directory.exists():
            raise NotADirectoryError(f"{directory}: is a file; expected a folder of MERL *.binary files")
        raise FileNotFoundError(f"{directory}: no such directory; expected a folder of MERL *.binary files")
    if not os.access(directory, os.R_OK | os.X_OK):
        raise PermissionError(f"{directory}: no permission to read this folder; change that (chmod), or name a copy")
    paths = _tables_in(directory)
    if not paths:
        folders = [path for path in _seen(directory) if path.is_dir()]
        below = [found for found in map(_tables_in, folders) if found]
        if not below:
            raise ValueError(f"{directory}: holds no materials; expected MERL *.binary files, found {_held(directory)}")
        if all(found[0].name == RESULT for found in below):
            return [path for found in below for path in found]
        if len(below) > 1:
            names = ", ".join(str(found[0].parent) for found in below)
            raise ValueError(f"{directory}: {len(below)} folders in it hold MERL *.binary files; name one: {names}")
        paths = below[0]
    first = {path.stem: path for path in reversed(paths)}
    for path in paths:
        same = first[path.stem]
        if same != path:
            raise ValueError(f"{path.parent}: {same.name} and {path.name} are of one name; keep one of them")
    return paths


def _listed(directory: Path) -> list[Path]:
    """What a folder holds, sorted by name; nothing where it must not be read."""
    try:
        return sorted(directory.iterdir())
    except PermissionError:
        return []


def _seen(directory: Path) -> list[Path]:
    """What a folder holds, less names that begin with a dot."""
    return [path for path in _listed(directory) if not path.name.startswith(".")]


def _tables_in(directory: Path) -> list[Path]:
    found = [path for path in _seen(directory) if path.suffix.lower() in TABLE_SUFFIXES]
    fitted = any(path.name == RESULT for path in found)
    return [path for path in found if not (fitted and path.name == RESULT_STD)]


def _held(directory: Path) -> str:
    """What a folder holds instead of tables, the most frequent kinds first."""
    kinds = Counter("folder" if path.is_dir() else path.suffix or "file without suffix" for path in _seen(directory))
    hidden = sum(path.name.startswith(".") and path.suffix.lower() in TABLE_SUFFIXES for path in _listed(directory))
    found = [f"{count} {kind}" for kind, count in kinds.most_common(_MOST_KINDS)]
    found += [f"{hidden} *.binary whose names begin with a dot"] if hidden else []
    return ", ".join(found) or "nothing"
