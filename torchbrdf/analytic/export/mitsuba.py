"""An analytic BRDF as a BSDF of Mitsuba 3, alone or in a small scene."""

import json
import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from torchbrdf.analytic.export._material_file import (
    check_native,
    checked_path,
    identifier,
    listed,
    rounded,
    write_whole,
    write_xml,
)
from torchbrdf.analytic.export.settings import SUFFIXES
from torchbrdf.analytic.table_fit import AnalyticFit

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


def mitsuba_bsdf(fit: AnalyticFit) -> dict[str, Any]:
    """The dictionary that `mitsuba.load_dict` makes a BSDF of; Mitsuba itself is not needed.

    Raises ValueError for a model that Mitsuba does not have, or with parameters of each channel.
    """
    check_native(fit, "Mitsuba", tuple(MITSUBA))
    fixed, names = MITSUBA[fit.model]
    described: dict[str, Any] = dict(fixed)
    for name, value in fit.parameters.items():
        numbers = [rounded(number) for number in value.tolist()]
        described[names.get(name, name)] = numbers[0] if len(numbers) == 1 else {"type": "rgb", "value": numbers}
    return described


def write_mitsuba(fit: AnalyticFit, path: str | os.PathLike[str]) -> None:
    """Write a scene that Mitsuba 3 renders, .xml, or the dictionary of `mitsuba_bsdf`, .json.

    The scene is a sphere under a softbox and constant light; its <bsdf> is complete in itself and may be copied.
    Raises ValueError for a model that Mitsuba does not have, or another suffix.
    """
    path = checked_path(path, "mitsuba", SUFFIXES["mitsuba"])
    described = mitsuba_bsdf(fit)
    if path.suffix.lower() == ".json":
        write_whole(path, (json.dumps(described, indent=1) + "\n").encode())
        return
    scene = ET.fromstring(_SCENE)
    (shape,) = (shape for shape in scene.iter("shape") if shape.get("type") == "sphere")
    bsdf = ET.Element("bsdf", type=described.pop("type"), id=identifier(fit.name))
    for name, value in described.items():
        if isinstance(value, dict):
            ET.SubElement(bsdf, "rgb", name=name, value=listed(value["value"]))
        else:
            kind = {bool: "boolean", float: "float", str: "string"}[type(value)]
            ET.SubElement(bsdf, kind, name=name, value=str(value).lower() if kind == "boolean" else str(value))
    scene.insert(list(scene).index(shape), ET.Comment(f" {fit} "))
    scene.insert(list(scene).index(shape), bsdf)
    ET.SubElement(shape, "ref", id=identifier(fit.name))
    write_xml(path, scene)


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
