"""The containers by suffix."""

from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from torchbrdf.files import existing_file
from torchbrdf.images.formats import jpeg, openexr, png
from torchbrdf.images.formats._stored import Stored


def readable_suffixes() -> tuple[str, ...]:
    """Of all containers, those of high dynamic range that most people have first."""
    return tuple(sorted(_by_suffix(), key=lambda suffix: (suffix not in (".exr", ".hdr"), suffix)))


def kind_by_suffix(path: Path) -> str | None:
    """What a picture with the suffix of this path is, such as "OpenEXR"; None where pictures have no such suffix."""
    module = _by_suffix().get(path.suffix.lower())
    return None if module is None else str(module.KIND)


def read_stored(path: Path, layer: str | None = None, vectors: bool = False, option: str = "") -> Stored:
    """What a file holds; raises as `existing_file`, and ValueError where it is not such a picture.

    layer    which of several pictures of an OpenEXR file
    vectors  prefer its channels X, Y, Z
    option   what names a layer on the command line; empty where nothing does
    """
    suffix = path.suffix.lower()
    module = _by_suffix().get(suffix)
    if module is None:
        if not path.exists():
            existing_file(path, "an image")
        known = ", ".join(readable_suffixes())
        raise ValueError(f"{path}: image suffix {path.suffix!r} is not supported; use {known}")
    existing_file(path, f"an image ({suffix})")
    _check_signature(path, module)
    if module is openexr:
        return openexr.read(path, layer, vectors, option)
    if layer is not None:
        what = f"{option} (layer= in Python)" if option else "layer"
        raise ValueError(f"{path}: {what} is for .exr files with several pictures; leave it out")
    stored: Stored = module.read(path)
    return stored


def exif_of(path: Path) -> bytes:
    """The block of EXIF data of a JPEG or PNG file that is there; none of other files."""
    module = _by_suffix().get(path.suffix.lower())
    return module.exif(path) if module in (jpeg, png) else b""


def _check_signature(path: Path, module: ModuleType) -> None:
    """Raise where a file begins as those of another container do."""
    with open(path, "rb") as file:
        beginning = file.read(16)
    if beginning.startswith(module.SIGNATURES):
        return
    for other in set(_by_suffix().values()):
        if beginning.startswith(other.SIGNATURES):
            name = path.with_suffix(other.SUFFIXES[0]).name
            raise ValueError(f"{path}: is a {other.KIND} file, not {module.KIND}; name it {name}")


@cache
def _by_suffix() -> dict[str, ModuleType]:
    return {suffix: module for module in _modules() for suffix in module.SUFFIXES}


def _modules() -> Iterator[ModuleType]:
    package = import_module(__package__)
    for found in iter_modules(package.__path__):
        if not found.name.startswith("_"):
            yield import_module(f"{__package__}.{found.name}")
