"""An analytic BRDF as a material of other programs: Mitsuba 3, glTF 2.0, MaterialX, or a table in MERL format.

Each program has models of its own, and a file holds the parameters of one of those: `native_fit` fits one to the table.
"""

import json
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from torchbrdf.analytic_fit import AnalyticFit, fit_analytic
from torchbrdf.analytic_models import MODELS
from torchbrdf.files import writing
from torchbrdf.gltf import glb_bytes, gltf_text
from torchbrdf.merl import MerlTable

METALLIC_ROUGHNESS = "metallic-roughness"
_NEGLIGIBLE = 1e-9

Plugin = tuple[Mapping[str, Any], Mapping[str, str]]
"""What a plugin of Mitsuba always gets, and its names of our parameters where they differ."""

MITSUBA: Mapping[str, Plugin] = MappingProxyType(
    {
        "principled": ({"type": "principled"}, {}),
        "rough-conductor": ({"type": "roughconductor", "distribution": "ggx"}, {"roughness": "alpha"}),
        "rough-plastic": (
            {"type": "roughplastic", "distribution": "ggx", "nonlinear": False, "ext_ior": 1.0},
            {
                "diffuse": "diffuse_reflectance",
                "specular": "specular_reflectance",
                "eta": "int_ior",
                "roughness": "alpha",
            },
        ),
    }
)
"""Our models that Mitsuba has. Its default `ext_ior` is that of air, 1.000277."""

SURFACES: Mapping[str, tuple[str, Mapping[str, str]]] = MappingProxyType(
    {
        "standard_surface": (
            "1.38",
            {
                "base": "1",
                "base_color": "base_color",
                "diffuse_roughness": "0",
                "metalness": "metallic",
                "specular": "1",
                "specular_color": "1, 1, 1",
                "specular_roughness": "roughness",
                "specular_IOR": "1.5",
            },
        ),
        "open_pbr_surface": (
            "1.39",
            {
                "base_weight": "1",
                "base_color": "base_color",
                "base_diffuse_roughness": "0",
                "base_metalness": "metallic",
                "specular_weight": "1",
                "specular_color": "1, 1, 1",
                "specular_roughness": "roughness",
                "specular_ior": "1.5",
            },
        ),
    }
)
"""MaterialX's surfaces: the first version of the format that has them, and inputs, each a value or a parameter of
metallic-roughness. An index of 1.5 is an F0 of 0.04, and alpha is the square of the roughness, as in glTF."""


def mitsuba_bsdf(fit: AnalyticFit) -> dict[str, Any]:
    """The dictionary that `mitsuba.load_dict` makes a BSDF of; Mitsuba itself is not needed.

    Raises ValueError for a model that Mitsuba does not have, or with parameters of each channel.
    """
    _check_native(fit, "Mitsuba", tuple(MITSUBA))
    fixed, names = MITSUBA[fit.model]
    described: dict[str, Any] = dict(fixed)
    for name, value in fit.parameters.items():
        numbers = [_rounded(number) for number in value.tolist()]
        described[names.get(name, name)] = numbers[0] if len(numbers) == 1 else {"type": "rgb", "value": numbers}
    return described


def write_mitsuba(fit: AnalyticFit, path: str | os.PathLike[str]) -> None:
    """Write a scene that Mitsuba 3 renders, .xml, or the dictionary of `mitsuba_bsdf`, .json.

    The scene is a sphere under a softbox and constant light; its <bsdf> is complete in itself and may be copied.
    Raises ValueError for a model that Mitsuba does not have, or another suffix.
    """
    path = _checked(path, "mitsuba")
    described = mitsuba_bsdf(fit)
    if path.suffix.lower() == ".json":
        _write(path, (json.dumps(described, indent=1) + "\n").encode())
        return
    scene = ET.fromstring(_SCENE)
    (shape,) = (shape for shape in scene.iter("shape") if shape.get("type") == "sphere")
    bsdf = ET.Element("bsdf", type=described.pop("type"), id=_identifier(fit.name))
    for name, value in described.items():
        if isinstance(value, dict):
            ET.SubElement(bsdf, "rgb", name=name, value=_listed(value["value"]))
        else:
            kind = {bool: "boolean", float: "float", str: "string"}[type(value)]
            ET.SubElement(bsdf, kind, name=name, value=str(value).lower() if kind == "boolean" else str(value))
    scene.insert(list(scene).index(shape), ET.Comment(f" {fit} "))
    scene.insert(list(scene).index(shape), bsdf)
    ET.SubElement(shape, "ref", id=_identifier(fit.name))
    _write_xml(path, scene)


def write_gltf(fit: AnalyticFit, path: str | os.PathLike[str]) -> None:
    """Write a sphere of the material, without textures, as glTF 2.0: .glb, or .gltf with the mesh inside.

    The mesh has positions and normals; a viewer brings camera and light. [Khr21]
    Raises ValueError for a model other than metallic-roughness, or another suffix.
    """
    path = _checked(path, "gltf")
    _check_native(fit, "glTF", (METALLIC_ROUGHNESS,))
    material = {
        "name": fit.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*_colour(fit, "base_color"), 1.0],
            "metallicFactor": _number(fit, "metallic"),
            "roughnessFactor": _number(fit, "roughness"),
        },
        "extras": {"torchbrdf": str(fit)},
    }
    _write(path, glb_bytes(material) if path.suffix.lower() == ".glb" else gltf_text(material).encode())


def write_materialx(fit: AnalyticFit, path: str | os.PathLike[str], surface: str = "standard_surface") -> None:
    """Write a MaterialX document, .mtlx, with one material.

    surface  "standard_surface", or "open_pbr_surface", whose metal has Schlick's F as metallic-roughness has; that of
             standard_surface differs towards grazing
    Raises ValueError for a model other than metallic-roughness, or another surface.
    """
    if surface not in SURFACES:
        raise ValueError(f"surface must be one of {', '.join(SURFACES)}, got {surface!r}")
    path = _checked(path, "materialx")
    _check_native(fit, "MaterialX", (METALLIC_ROUGHNESS,))
    name = _identifier(fit.name)
    version, inputs = SURFACES[surface]
    document = ET.Element("materialx", version=version, colorspace="lin_rec709")
    shader = ET.SubElement(document, surface, name=f"{name}_shader", type="surfaceshader")
    fitted = {name: repr(_number(fit, name)) for name in ("metallic", "roughness")}
    fitted["base_color"] = _listed(_colour(fit, "base_color"))
    for key, value in inputs.items():
        kind = "color3" if key.endswith("color") else "float"
        ET.SubElement(shader, "input", name=key, type=kind, value=fitted.get(value, value))
    material = ET.SubElement(document, "surfacematerial", name=name, type="material", doc=str(fit))
    ET.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"{name}_shader")
    _write_xml(path, document)


def write_binary(fit: AnalyticFit, path: str | os.PathLike[str]) -> None:
    """Write the model, whatever it is, as a table in MERL format, .binary."""
    fit.table.save(_checked(path, "binary"))


@dataclass(frozen=True)
class Format:
    """A kind of file.

    suffixes  of its files; the first is the usual one
    write     (fit, path)
    models    that it holds, the one that others are carried over to first; empty: all
    caution   where the other program evaluates the same parameters otherwise
    """

    name: str
    suffixes: tuple[str, ...]
    write: Callable[[AnalyticFit, Path], None]
    models: tuple[str, ...] = ()
    caution: str = ""

    def holds(self, fit: AnalyticFit) -> bool:
        """Whether a file can say what was fitted."""
        return not self.models or (fit.model in self.models and _shared(fit))


def _write_openpbr(fit: AnalyticFit, path: Path) -> None:
    write_materialx(fit, path, "open_pbr_surface")


_EXACT = "takes the exact F of an index of 1.5 for what is no metal, not Schlick's"

FORMATS: Mapping[str, Format] = MappingProxyType(
    {
        one.name: one
        for one in (
            Format("mitsuba", (".xml", ".json"), write_mitsuba, tuple(MITSUBA)),
            Format("gltf", (".glb", ".gltf"), write_gltf, (METALLIC_ROUGHNESS,)),
            Format(
                "materialx",
                (".mtlx",),
                write_materialx,
                (METALLIC_ROUGHNESS,),
                f"standard_surface {_EXACT}, and metals of its own, brighter towards grazing; openpbr is nearer",
            ),
            Format("openpbr", (".mtlx",), _write_openpbr, (METALLIC_ROUGHNESS,), f"open_pbr_surface {_EXACT}"),
            Format("binary", (".binary",), write_binary),
        )
    }
)


def format_of(path: Path, name: str | None = None) -> Format:
    """The format of a file, by its name or else by the file's suffix.

    Raises ValueError for an unknown format, a suffix of none, or of another one.
    """
    suffix = path.suffix.lower()
    if name is None:
        for one in FORMATS.values():
            if suffix in one.suffixes:
                return one
        known = ", ".join(f"{suffix} ({one.name})" for one in FORMATS.values() for suffix in one.suffixes)
        raise ValueError(f"{path}: no format has the suffix {suffix!r}; use one of {known}")
    if name not in FORMATS:
        raise ValueError(f"format must be one of {', '.join(FORMATS)}, got {name!r}")
    if suffix not in FORMATS[name].suffixes:
        raise ValueError(f"{path}: a {name} file ends in {' or '.join(FORMATS[name].suffixes)}, not in {suffix!r}")
    return FORMATS[name]


def native_fit(fit: AnalyticFit, table: MerlTable, wanted: Format, **options: Any) -> AnalyticFit:
    """What a file of a format holds: the fit, or one of the format's own model to the same table in the same metric.

    options  of `fit_analytic`: uncertainty, largest_angle_deg, most_evaluations
    """
    return fit if wanted.holds(fit) else fit_analytic(table, wanted.models[0], fit.metric, **options)


def _checked(path: str | os.PathLike[str], name: str) -> Path:
    format_of(Path(path), name)
    return Path(path)


def _check_native(fit: AnalyticFit, program: str, models: tuple[str, ...]) -> None:
    if fit.model not in models:
        raise ValueError(
            f"{program} has no model {fit.model}; fit {' or '.join(models)} to the same table, as native_fit does"
        )
    if not _shared(fit):
        raise ValueError(f"{program} has one number for all channels of what is no colour; fit with shared=True")


def _shared(fit: AnalyticFit) -> bool:
    return all(p.colour or len(fit.parameters[p.name]) == 1 for p in MODELS[fit.model].parameters)


def _number(fit: AnalyticFit, name: str) -> float:
    return _rounded(fit.parameters[name].item())


def _colour(fit: AnalyticFit, name: str) -> list[float]:
    return [_rounded(number) for number in fit.parameters[name].expand(3).tolist()]


def _listed(numbers: list[float]) -> str:
    return ", ".join(map(repr, numbers))


def _rounded(number: float) -> float:
    """To seven digits; what is as good as 0 is 0."""
    return float(f"{number:.7g}") if number > _NEGLIGIBLE else 0.0


def _identifier(name: str) -> str:
    """A name as XML and MaterialX take it for an identifier."""
    word = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return word if word[:1].isalpha() else f"material_{word}".rstrip("_")


def _write(path: Path, content: bytes) -> None:
    with writing(path) as temporary:
        temporary.write_bytes(content)


def _write_xml(path: Path, root: ET.Element) -> None:
    ET.indent(root, "    ")
    _write(path, ET.tostring(root, "utf-8", xml_declaration=True) + b"\n")


_SCENE = """\
<scene version="3.0.0">
    <default name="spp" value="256"/>
    <default name="size" value="512"/>
    <integrator type="path"/>
    <sensor type="perspective">
        <float name="fov" value="25"/>
        <transform name="to_world">
            <lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$size"/>
            <integer name="height" value="$size"/>
        </film>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
    </sensor>
    <emitter type="constant">
        <rgb name="radiance" value="0.3, 0.3, 0.3"/>
    </emitter>
    <shape type="rectangle">
        <transform name="to_world">
            <lookat origin="-4, 5, 4" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <emitter type="area">
            <rgb name="radiance" value="40, 40, 40"/>
        </emitter>
    </shape>
    <shape type="sphere"/>
</scene>
"""
