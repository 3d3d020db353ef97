"""An analytic BRDF as the material of a sphere in a glTF 2.0 file [Khr21]."""

import base64
import json
import os
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from torchbrdf._version import __version__
from torchbrdf.analytic.export._material_file import (
    METALLIC_ROUGHNESS,
    check_native,
    checked_path,
    colour,
    number,
    write_whole,
)
from torchbrdf.analytic.export.settings import SUFFIXES
from torchbrdf.analytic.table_fit import AnalyticFit

_SUBDIVISIONS = 4
"""Of an icosahedron: 2562 vertices; the silhouette is within 0.1 % of a circle."""

_FLOAT, _UNSIGNED_SHORT, _VERTICES, _TRIANGLES = 5126, 5123, 34962, 34963


def write_gltf(fit: AnalyticFit, path: str | os.PathLike[str]) -> None:
    """Write a sphere of the material, without textures, as glTF 2.0: .glb, or .gltf with the mesh inside.

    The mesh has positions and normals; a viewer brings camera and light. [Khr21]
    Raises ValueError for a model other than metallic-roughness, or another suffix.
    """
    path = checked_path(path, "gltf", SUFFIXES["gltf"])
    check_native(fit, "glTF", (METALLIC_ROUGHNESS,))
    material = {
        "name": fit.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*colour(fit, "base_color"), 1.0],
            "metallicFactor": number(fit, "metallic"),
            "roughnessFactor": number(fit, "roughness"),
        },
        "extras": {"torchbrdf": str(fit)},
    }
    write_whole(path, _glb_bytes(material) if path.suffix.lower() == ".glb" else _gltf_text(material).encode())


def _gltf_text(material: Mapping[str, Any]) -> str:
    """The content of a .gltf file, with its buffer inside.

    material  as in the list "materials" of glTF
    """
    document, binary = _sphere(material)
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{base64.b64encode(binary).decode()}"
    return json.dumps(document, indent=1) + "\n"


def _glb_bytes(material: Mapping[str, Any]) -> bytes:
    """The content of a .glb file: chunks padded to 4 bytes [Khr21, sec. 4.4]."""
    document, binary = _sphere(material)
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _sphere(material: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
    """A document of a unit sphere, and the bytes of its buffer."""
    from trimesh.creation import icosphere

    sphere = icosphere(subdivisions=_SUBDIVISIONS)
    normals = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1, keepdims=True)
    positions = np.ascontiguousarray(normals, "<f4")
    parts = (positions.tobytes(), positions.tobytes(), np.ascontiguousarray(sphere.faces, "<u2").tobytes())
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    vector = {"componentType": _FLOAT, "count": len(positions), "type": "VEC3"}
    corners = {"componentType": _UNSIGNED_SHORT, "count": sphere.faces.size, "type": "SCALAR"}
    limits = {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"torchbrdf {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "sphere"}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [dict(material)],
        "accessors": [
            {"bufferView": 0, **vector, **limits},
            {"bufferView": 1, **vector},
            {"bufferView": 2, **corners},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part), "target": target}
            for start, part, target in zip(starts, parts, (_VERTICES, _VERTICES, _TRIANGLES), strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    return document, b"".join(parts)
