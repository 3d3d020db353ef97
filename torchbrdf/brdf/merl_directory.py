"""A directory of MERL files: which of them are sound, and which of the 100 materials are there [MPBM03]."""

import os
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from torchbrdf.brdf.merl import MerlTable

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


@dataclass(frozen=True)
class DirectoryReport:
    """What `verify` found: sound tables, unsound ones with what is wrong, and missing MERL materials."""

    sound: tuple[str, ...]
    unsound: dict[str, str]
    missing: tuple[str, ...]


def table_paths(directory: str | os.PathLike[str]) -> list[Path]:
    """The `.binary` files of a directory, sorted by name. Raises where there is no directory or no file."""
    directory = Path(directory)
    if not directory.is_dir():
        raise FileNotFoundError(f"{directory}: no such directory; expected a folder of MERL *.binary files")
    paths = sorted(directory.glob("*.binary"))
    if not paths:
        raise ValueError(f"{directory}: holds no materials; expected MERL *.binary files")
    return paths


def verify(directory: str | os.PathLike[str], progress: bool = False) -> DirectoryReport:
    """Read every `.binary` file of a directory and say which are sound, which are not and why, and what is missing."""
    sound, unsound = [], {}
    paths = table_paths(directory)
    for path in tqdm(paths, desc="reading", disable=not progress, leave=False):
        try:
            MerlTable.open(path)
            sound.append(path.stem)
        except (OSError, ValueError) as error:
            unsound[path.stem] = str(error)
    present = {path.stem for path in paths}
    return DirectoryReport(tuple(sound), unsound, tuple(name for name in MERL_MATERIALS if name not in present))
