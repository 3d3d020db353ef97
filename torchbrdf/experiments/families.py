"""Whom a target has among the materials of a library: itself, and the family it was made with.

A library that holds what is to be recovered from it measures nothing, and one that holds the same paint in another
colour measures little: what is told about accuracy is told without a target's family first.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, get_args

from torchbrdf.brdf import MaterialLibrary

Relation = Literal["family", "material"]
RELATIONS: tuple[Relation, ...] = get_args(Relation)

_LONG_FAMILIES = ("acrylic_felt", "irid_flake")
"""Of the RGL database: those that two words name; others have one, as `cc` or `vch`."""


def family(material: str) -> str:
    """The paint line or kind of an RGL material, which its name begins with; other names are a family each."""
    name = _bare(material)
    long = next((known for known in _LONG_FAMILIES if name.startswith(f"{known}_")), None)
    return long or name.split("_")[0]


def relatives(material: str, names: Sequence[str], relation: Relation = "family") -> tuple[str, ...]:
    """Those of `names` that are the material itself, or of its family. Case and where a file lies do not matter."""
    key = family if relation == "family" else _bare
    return tuple(name for name in names if key(name) == key(material))


def by_relatives(
    materials: Sequence[str], names: Sequence[str], relation: Relation = "family"
) -> dict[tuple[str, ...], list[str]]:
    """Materials by which of `names` are their `relatives`: those of a group are recovered from the same library."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for material in materials:
        groups.setdefault(relatives(material, names, relation), []).append(material)
    return groups


def without_relatives(library: MaterialLibrary, material: str) -> MaterialLibrary:
    """The library less the family of a material; the same object for the same family, and itself where it has none."""
    return _without(library, relatives(material, library.names))


@lru_cache(maxsize=32)
def _without(library: MaterialLibrary, names: tuple[str, ...]) -> MaterialLibrary:
    return library.without(*names) if names else library


def _bare(material: str) -> str:
    return material.rsplit("/", 1)[-1].lower().removesuffix("_rgb").removesuffix("_spec")
