"""A file of an analytic BRDF for another program: what it can hold, and the numbers, names and bytes in it."""

import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from torchbrdf.analytic.table_fit import AnalyticFit
from torchbrdf.files import writing

METALLIC_ROUGHNESS = "metallic-roughness"
"""The model of glTF, whose parameters the surfaces of MaterialX take, too."""

_NEGLIGIBLE = 1e-9


def checked_path(path: str | os.PathLike[str], name: str, suffixes: tuple[str, ...]) -> Path:
    """The path of a file of a format. Raises ValueError for a suffix that is none of the format's."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise ValueError(f"{path}: a {name} file ends in {' or '.join(suffixes)}, not in {suffix!r}")
    return path


def check_native(fit: AnalyticFit, program: str, models: tuple[str, ...]) -> None:
    """Raise ValueError for a model that a program does not have, or with parameters of each channel."""
    if fit.model not in models:
        raise ValueError(
            f"{program} has no model {fit.model}; fit {' or '.join(models)} to the same table, as native_fit does"
        )
    if not fit.shared:
        raise ValueError(f"{program} has one number for all channels of what is no colour; fit with shared=True")


def number(fit: AnalyticFit, name: str) -> float:
    """A parameter that is one number."""
    return rounded(fit.parameters[name].item())


def colour(fit: AnalyticFit, name: str) -> list[float]:
    """A parameter as three numbers."""
    return [rounded(value) for value in fit.parameters[name].expand(3).tolist()]


def rounded(value: float) -> float:
    """To seven digits; what is as good as 0 is 0."""
    return float(f"{value:.7g}") if value > _NEGLIGIBLE else 0.0


def listed(numbers: list[float]) -> str:
    """Numbers as the attribute of an XML element has them."""
    return ", ".join(map(repr, numbers))


def identifier(name: str) -> str:
    """A name as XML and MaterialX take it for an identifier."""
    word = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return word if word[:1].isalpha() else f"material_{word}".rstrip("_")


def write_whole(path: Path, content: bytes) -> None:
    """Write a file, or nothing."""
    with writing(path) as temporary:
        temporary.write_bytes(content)


def write_xml(path: Path, root: ET.Element) -> None:
    """Write a document, indented, or nothing."""
    ET.indent(root, "    ")
    write_whole(path, ET.tostring(root, "utf-8", xml_declaration=True) + b"\n")
