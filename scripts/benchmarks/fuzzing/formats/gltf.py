"""glTF: text with its numbers inside or beside it, and `.glb`."""

import base64
import json
import struct
from collections.abc import Sequence
from random import Random
from typing import Any

import numpy as np

from fuzzing.files import InputFile
from fuzzing.mutations import mutated_bytes, mutated_json

_TEXT, _BINARY = 0x4E4F534A, 0x004E4942
_CORNERS = np.array(((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)), "<f4")
_TRIANGLES = np.array(((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)))


def seeds() -> list[InputFile]:
    """Tetrahedra."""
    documents = {
        "plain": _document(),
        "indices of 8 bits": _document(index="u1"),
        "indices of 32 bits": _document(index="<u4"),
        "no indices": _document(index=None),
        "normals": _document(normals=True),
        "strip": _document(mode=5),
        "fan": _document(mode=6),
        "points": _document(mode=0),
    }
    turned, binary = _document()
    turned["nodes"] = [{"children": [1, 2]}, {"mesh": 0, "scale": [2, 1, 1], "rotation": [0, 0.6, 0, 0.8]},
                       {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1]}]  # fmt: skip
    documents["turned"] = turned, binary
    sparse, binary = _document()
    sparse["accessors"][0]["sparse"] = {
        "count": 1, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 0},
    }  # fmt: skip
    documents["sparse"] = sparse, binary
    dressed, binary = _document()
    dressed["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    dressed["textures"], dressed["images"] = [{"source": 0}], [{"uri": "red.png"}]
    dressed["meshes"][0]["primitives"][0]["material"] = 0
    documents["dressed"] = dressed, binary
    files = []
    for name, (document, binary) in documents.items():
        files.append(InputFile(f"{name}, binary", ".glb", _glb(document, binary)))
        inside = json.loads(json.dumps(document))
        inside["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
        files.append(InputFile(name, ".gltf", json.dumps(inside).encode()))
    beside = json.loads(json.dumps(documents["plain"][0]))
    beside["buffers"][0]["uri"] = "beside.bin"
    return [*files, InputFile("numbers in a file that is not there", ".gltf", json.dumps(beside).encode())]


def mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change an entry of the text, or the numbers; lengths agree again but for some."""
    if not content.startswith(b"glTF"):
        return mutated_json(content, rng)
    (size,) = struct.unpack_from("<I", content, 12)
    text, rest = content[20 : 20 + size], content[20 + size :]
    if rng.random() < 0.2:
        return content[: 20 + size] + mutated_bytes(rest, rng, others)
    text = mutated_json(text, rng)
    text += b" " * (-len(text) % 4)
    whole = rng.choice((20 + len(text) + len(rest),) * 9 + (0, (1 << 32) - 1))
    return struct.pack("<4sIIII", b"glTF", 2, whole, len(text), _TEXT) + text + rest


def _document(index: str | None = "<u2", normals: bool = False, mode: int = 4) -> tuple[dict[str, Any], bytes]:
    indices = b"" if index is None else _TRIANGLES.astype(index).tobytes()
    binary = _CORNERS.tobytes() + (indices + bytes(-len(indices) % 4)) + _CORNERS.tobytes() * normals
    views: list[dict[str, Any]] = [{"buffer": 0, "byteOffset": 0, "byteLength": 48, "target": 34962}]
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]}
    ]
    primitive: dict[str, Any] = {"attributes": {"POSITION": 0}, "mode": mode}
    if index is not None:
        views.append({"buffer": 0, "byteOffset": 48, "byteLength": len(indices)})
        kind = {"u1": 5121, "<u2": 5123, "<u4": 5125}[index]
        accessors.append({"bufferView": 1, "componentType": kind, "count": _TRIANGLES.size, "type": "SCALAR"})
        primitive["indices"] = 1
    if normals:
        views.append({"buffer": 0, "byteOffset": len(binary) - 48, "byteLength": 48, "byteStride": 12})
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": 4, "type": "VEC3"})
        primitive["attributes"]["NORMAL"] = len(accessors) - 1
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}], "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    return document, binary


def _glb(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    held = struct.pack("<II", len(text), _TEXT) + text + struct.pack("<II", len(binary), _BINARY) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(held)) + held
