"""An analytic BRDF as a surface of MaterialX, in a document of its own."""

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from types import MappingProxyType

from torchbrdf.analytic.export._material_file import (
    METALLIC_ROUGHNESS,
    check_native,
    checked_path,
    colour,
    identifier,
    listed,
    number,
    write_xml,
)
from torchbrdf.analytic.export.settings import SUFFIXES
from torchbrdf.analytic.table_fit import AnalyticFit

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


def write_materialx(fit: AnalyticFit, path: str | os.PathLike[str], surface: str = "standard_surface") -> None:
    """Write a MaterialX document, .mtlx, with one material.

    surface  "standard_surface", or "open_pbr_surface", whose metal has Schlick's F as metallic-roughness has; that of
             standard_surface differs towards grazing
    Raises ValueError for a model other than metallic-roughness, or another surface.
    """
    if surface not in SURFACES:
        raise ValueError(f"surface must be one of {', '.join(SURFACES)}, got {surface!r}")
    path = checked_path(path, "materialx", SUFFIXES["materialx"])
    check_native(fit, "MaterialX", (METALLIC_ROUGHNESS,))
    name = identifier(fit.name)
    version, inputs = SURFACES[surface]
    document = ET.Element("materialx", version=version, colorspace="lin_rec709")
    shader = ET.SubElement(document, surface, name=f"{name}_shader", type="surfaceshader")
    fitted = {name: repr(number(fit, name)) for name in ("metallic", "roughness")}
    fitted["base_color"] = listed(colour(fit, "base_color"))
    for key, value in inputs.items():
        kind = "color3" if key.endswith("color") else "float"
        ET.SubElement(shader, "input", name=key, type=kind, value=fitted.get(value, value))
    material = ET.SubElement(document, "surfacematerial", name=name, type="material", doc=str(fit))
    ET.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"{name}_shader")
    write_xml(path, document)
