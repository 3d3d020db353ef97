"""glTF 2.0, .glb and .gltf: the triangles of a scene, each placed by its node."""

import base64
import binascii
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from torchbrdf.view._polygons import Polygons

_MAGIC = b"glTF"
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "EXT_lights_", "KHR_mesh_quantization")
"""Extensions that a file may require: they change no shape, or (the last) only kinds of numbers."""

_GEOMETRY = (
    "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression", "EXT_mesh_gpu_instancing"
)  # fmt: skip
_MOST_CORNERS = 1 << 27
"""Small files can name the same triangles as often as they like."""


def read_gltf(content: bytes, folder: Path) -> list[Polygons]:
    """The primitives of the scene's nodes; buffers may lie beside the file, in its folder.

    Raises ValueError where the file is damaged or needs what is not read: compression, sparse accessors, skins and
    morph targets.
    """
    try:
        return _Document(content, folder).parts()
    except (LookupError, TypeError, AttributeError, OverflowError, RecursionError, struct.error) as error:
        raise ValueError(f"it does not follow glTF 2.0 ({type(error).__name__}: {str(error)[:80]})") from None


class _Document:
    """The JSON of a file and its buffers."""

    def __init__(self, content: bytes, folder: Path) -> None:
        text, self._binary = _chunks(content)
        self._folder = folder
        self._buffers: dict[int, bytes] = {}
        try:
            self._json = json.loads(text)
        except ValueError as error:
            raise ValueError(f"it holds no sound JSON ({error})") from None
        version = str(self._json["asset"]["version"])
        if not version.startswith("2."):
            raise ValueError(f"it is glTF {version[:10]}; export it as glTF 2.0")
        for name in self._json.get("extensionsRequired", []):
            if not name.startswith(_HARMLESS):
                raise _unread(name)

    def parts(self) -> list[Polygons]:
        found: list[Polygons] = []
        n_corners = 0
        for mesh, matrix in self._placed_meshes():
            for primitive in self._entry("meshes", mesh)["primitives"]:
                part = self._primitive(primitive)
                if part is not None:
                    n_corners += len(part.corners) + len(part.vertices)
                    if n_corners > _MOST_CORNERS:
                        raise ValueError(f"its nodes repeat its meshes to more than {_MOST_CORNERS} corners")
                    found.append(_placed(part, matrix))
        return found

    def _entry(self, kind: str, index: int) -> dict[str, Any]:
        if type(index) is not int or not 0 <= index < len(self._json.get(kind, [])):
            raise ValueError(f"it names entry {index} of its {len(self._json.get(kind, []))} {kind}")
        return self._json[kind][index]

    def _placed_meshes(self) -> Iterator[tuple[int, np.ndarray]]:
        """Meshes and the matrices (4, 4) of their nodes."""
        nodes = self._json.get("nodes", [])
        if self._json.get("scenes"):
            roots = self._entry("scenes", self._json.get("scene", 0)).get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [index for index in range(len(nodes)) if index not in children]
            if not nodes:
                yield from ((index, np.eye(4)) for index in range(len(self._json.get("meshes", []))))
        waiting, seen = [(index, np.eye(4)) for index in roots], set()
        while waiting:
            index, above = waiting.pop()
            if index in seen:
                raise ValueError(f"its node {index} hangs at two places")
            seen.add(index)
            node = self._entry("nodes", index)
            matrix = above @ _matrix(node)
            for name in node.get("extensions", {}):
                if name in _GEOMETRY:
                    raise _unread(name)
            if "mesh" in node:
                mesh = self._entry("meshes", node["mesh"])
                if "skin" in node:
                    raise ValueError("it is posed by a skeleton; export it with the pose applied, without skin")
                if any(node.get("weights", mesh.get("weights", []))):
                    raise ValueError("it is shaped by morph targets; export it with the shape applied, without them")
                yield node["mesh"], matrix
            waiting += [(child, matrix) for child in node.get("children", [])]

    def _primitive(self, primitive: dict[str, Any]) -> Polygons | None:
        """Its triangles; None where it has none, but points or lines."""
        mode, attributes = primitive.get("mode", _TRIANGLES), primitive["attributes"]
        if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in attributes:
            return None
        position = self._entry("accessors", attributes["POSITION"])
        for name in primitive.get("extensions", {}):
            if name in _GEOMETRY and "bufferView" not in position:  # else the plain numbers are there, too
                raise _unread(name)
        vertices = self._numbers(attributes["POSITION"], "VEC3")
        normals = self._numbers(attributes["NORMAL"], "VEC3") if "NORMAL" in attributes else None
        if normals is not None and len(normals) != len(vertices):
            raise ValueError(f"a part has {len(vertices)} vertices and {len(normals)} normals")
        corners = np.arange(len(vertices))
        if "indices" in primitive:
            corners = self._numbers(primitive["indices"], "SCALAR").ravel().astype(np.int64)
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise ValueError(f"a part has {len(corners)} corners, which make no whole triangles")
        elif mode == _FAN:
            corners = np.stack([np.broadcast_to(corners[:1], corners[2:].shape), corners[1:-1], corners[2:]], 1).ravel()
        else:
            odd = np.arange(max(len(corners) - 2, 0)) % 2
            third = np.arange(len(odd)) + 2
            corners = np.stack([corners[third - 2 + odd], corners[third - 1 - odd], corners[third]], 1).ravel()
        return Polygons(vertices, np.full(len(corners) // 3, 3), corners, normals)

    def _numbers(self, index: int, shape: str) -> np.ndarray:
        """An accessor: (N, 3) or (N, 1), float64 where it is normalised or of vectors."""
        accessor = self._entry("accessors", index)
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError(f"its accessor {index} is sparse or empty, which is not read; export it plain")
        if accessor["type"] != shape:
            raise ValueError(f"its accessor {index} holds {accessor['type']} in place of {shape}")
        view = self._entry("bufferViews", accessor["bufferView"])
        for name in view.get("extensions", {}):
            if name in _GEOMETRY:
                raise _unread(name)
        kind, width = np.dtype(_KINDS[accessor["componentType"]]), 3 if shape == "VEC3" else 1
        count, start, offset = accessor["count"], view.get("byteOffset", 0), accessor.get("byteOffset", 0)
        size = width * kind.itemsize
        stride = view.get("byteStride", size)
        content = self._buffer(view["buffer"])
        if any(type(number) is not int or number < 0 for number in (count, start, offset, stride)) or stride < size:
            raise ValueError(f"its accessor {index} has a negative or broken size")
        needed = offset + (count - 1) * stride + size if count else 0
        if needed > view["byteLength"] or start + needed > len(content):
            raise ValueError(f"its accessor {index} is longer than its data; is the file truncated?")
        found = np.ndarray((count, width), kind, content, start + offset, (stride, kind.itemsize))
        if accessor.get("normalized") and kind.kind != "f":
            return np.maximum(found / np.iinfo(kind).max, -1)
        return found.astype(np.float64) if shape == "VEC3" else found

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            buffer = self._entry("buffers", index)
            self._buffers[index] = self._outside(buffer["uri"]) if "uri" in buffer else self._binary
        return self._buffers[index]

    def _outside(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            try:
                return base64.b64decode(text, validate=True) if head.endswith(";base64") else b""
            except binascii.Error:
                raise ValueError("its data URI is not base64") from None
        path = self._folder / unquote(uri)
        try:
            there = bool(uri) and "://" not in uri and "\0" not in uri and path.is_file()
        except OSError:  # no system has such names
            there = False
        if not there:
            raise ValueError(f"its numbers lie in {uri[:80]!r}, which is not there; keep both together or give a .glb")
        return path.read_bytes()


def _chunks(content: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk of a .glb file; a .gltf file is JSON as a whole."""
    if not content.startswith(_MAGIC):
        return content, b""
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise ValueError(f"it is glTF {version}; export it as glTF 2.0")
    if length > len(content):
        raise ValueError(f"its header promises {length} bytes and it has {len(content)}; is it truncated?")
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", content, at)
        if at + 8 + size > length:
            raise ValueError("a chunk is longer than the file; is it truncated?")
        found.setdefault(kind, content[at + 8 : at + 8 + size])
        at += 8 + size
    if _JSON not in found:
        raise ValueError("it holds no JSON chunk")
    return found[_JSON], found.get(_BINARY, b"")


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """(4, 4) float64 from a node to the one above."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), float)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), float).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", (0, 0, 0)), float).reshape(3)
    return matrix


def _placed(part: Polygons, matrix: np.ndarray) -> Polygons:
    """Moved by a matrix (4, 4); one that mirrors turns the triangles round."""
    if np.array_equal(matrix, np.eye(4)):
        return part
    linear = matrix[:3, :3]
    mirrored = np.linalg.det(linear) < 0
    corners = part.corners.reshape(-1, 3)[:, ::-1].ravel() if mirrored else part.corners
    normals = part.normals
    if normals is not None:
        a, b, c = linear.T
        turned = normals @ np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) * (-1 if mirrored else 1)
        lengths = np.linalg.norm(turned, axis=1, keepdims=True)
        normals = turned / np.where(lengths > 0, lengths, 1) * np.linalg.norm(normals, axis=1, keepdims=True)
    return Polygons(part.vertices @ linear.T + matrix[:3, 3], part.counts, corners, normals)


def _unread(extension: str) -> ValueError:
    return ValueError(f"it needs the extension {extension}, which is not read; export it without (plain glTF 2.0)")
