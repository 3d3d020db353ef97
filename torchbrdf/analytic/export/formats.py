"""An analytic BRDF as a material of other programs: Mitsuba 3, glTF 2.0, MaterialX, or a table in MERL format.

Each program has models of its own, and a file holds the parameters of one of those: `native_fit` fits one to the table.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from torchbrdf.analytic.export._material_file import METALLIC_ROUGHNESS, checked_path
from torchbrdf.analytic.export.gltf import write_gltf
from torchbrdf.analytic.export.materialx import write_materialx
from torchbrdf.analytic.export.mitsuba import MITSUBA, write_mitsuba
from torchbrdf.analytic.export.settings import SUFFIXES
from torchbrdf.analytic.image_fit import PIXELS
from torchbrdf.analytic.settings import DEFAULT_MODEL
from torchbrdf.analytic.table_fit import AnalyticFit, fit_analytic
from torchbrdf.arguments import check_types
from torchbrdf.brdf import MerlTable


def write_binary(fit: AnalyticFit, path: str | os.PathLike[str]) -> None:
    """Write the model, whatever it is, as a table in MERL format, .binary."""
    fit.table.save(checked_path(path, "binary", SUFFIXES["binary"]))


@dataclass(frozen=True)
class Format:
    """A kind of file.

    suffixes  of its files; the first is the usual one
    write     (fit, path)
    models    that it holds, the one that others are carried over to first; empty: all
    note      where the other program evaluates the same parameters otherwise
    """

    name: str
    suffixes: tuple[str, ...]
    write: Callable[[AnalyticFit, Path], None]
    models: tuple[str, ...] = ()
    note: str = ""

    @property
    def model(self) -> str:
        """What is fitted for it where no model is named."""
        return self.models[0] if self.models else DEFAULT_MODEL

    def holds(self, fit: AnalyticFit) -> bool:
        """Whether a file can say what was fitted."""
        return not self.models or (fit.model in self.models and fit.shared)


def _write_openpbr(fit: AnalyticFit, path: Path) -> None:
    write_materialx(fit, path, "open_pbr_surface")


_EXACT = "takes the exact F of an index of 1.5 for what is no metal, not Schlick's"

FORMATS: Mapping[str, Format] = MappingProxyType(
    {
        one.name: one
        for one in (
            Format("mitsuba", SUFFIXES["mitsuba"], write_mitsuba, tuple(MITSUBA)),
            Format("gltf", SUFFIXES["gltf"], write_gltf, (METALLIC_ROUGHNESS,)),
            Format(
                "materialx",
                SUFFIXES["materialx"],
                write_materialx,
                (METALLIC_ROUGHNESS,),
                f"standard_surface {_EXACT}, and metals of its own, brighter towards grazing; openpbr is nearer",
            ),
            Format("openpbr", SUFFIXES["openpbr"], _write_openpbr, (METALLIC_ROUGHNESS,), f"open_pbr_surface {_EXACT}"),
            Format("binary", SUFFIXES["binary"], write_binary),
        )
    }
)


def format_of(path: Path, name: str | None = None) -> Format:
    """The format of a file, by its name or else by the file's suffix.

    Raises ValueError for an unknown format, a suffix of none, or of another one.
    """
    if name is None:
        suffix = path.suffix.lower()
        for one in FORMATS.values():
            if suffix in one.suffixes:
                return one
        raise ValueError(f"{path}: no format has the suffix {suffix!r}; use one of {_known_suffixes()}")
    if name not in FORMATS:
        raise ValueError(f"format must be one of {', '.join(FORMATS)}, got {name!r}")
    checked_path(path, name, FORMATS[name].suffixes)
    return FORMATS[name]


def _known_suffixes() -> str:
    """Every suffix with its formats, the one first that is taken where `--format` says nothing."""
    names: dict[str, list[str]] = {}
    for one in FORMATS.values():
        for suffix in one.suffixes:
            names.setdefault(suffix, []).append(one.name)
    return ", ".join(f"{suffix} ({_choice(formats)})" for suffix, formats in names.items())


def _choice(names: list[str]) -> str:
    first, *others = names
    return first + "".join(f", or {other} with --format {other}" for other in others)


def native_fit(fit: AnalyticFit, table: MerlTable, wanted: Format, **options: Any) -> AnalyticFit:
    """What a file of a format holds: the fit, or one of the format's own model to the same table in the same metric.

    fit      of `table`; one of a photograph only where a file can say what was fitted
    wanted   one of `FORMATS`
    options  of `fit_analytic`: uncertainty, largest_angle_deg, most_evaluations
    Raises ValueError for a fit of a photograph that the file cannot say: carried over to a table it would lose that.
    """
    check_types("native_fit", fit=(fit, AnalyticFit), table=(table, MerlTable), wanted=(wanted, Format))
    if wanted.holds(fit):
        return fit
    if fit.metric == PIXELS:
        raise ValueError(
            f"{fit.model} was fitted to a photograph, and a {wanted.name} file holds {' or '.join(wanted.models)}; fit "
            f'that to the photograph: fit_analytic_to_image(image, probe, view, "{wanted.model}", start=...)'
        )
    return fit_analytic(table, wanted.models[0], fit.metric, **options)
