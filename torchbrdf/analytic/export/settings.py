"""The formats of materials and the suffixes of their files, the usual one first; without torch, for `--help`."""

from collections.abc import Mapping
from types import MappingProxyType

SUFFIXES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "mitsuba": (".xml", ".json"),
        "gltf": (".glb", ".gltf"),
        "materialx": (".mtlx",),
        "openpbr": (".mtlx",),
        "binary": (".binary",),
    }
)
