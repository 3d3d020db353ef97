"""Meshes as text and as PLY: polygons, normals, relative and missing indices, every number type of PLY."""

import struct
from collections.abc import Sequence
from random import Random

from fuzzing.files import InputFile
from fuzzing.mutations import mutated_bytes, mutated_text

_CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
_QUADS = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (2, 3, 7, 6), (1, 2, 6, 5), (0, 4, 7, 3))
_TRIANGLES = tuple(tuple(quad[i] for i in corners) for quad in _QUADS for corners in ((0, 1, 2), (0, 2, 3)))
_NUMBERS = {"uchar": "B", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}


def obj_seeds() -> list[InputFile]:
    """Cubes, and a concave polygon."""
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in _CORNERS)
    quads, triangles = _obj_faces(_QUADS, "{i}"), _obj_faces(_TRIANGLES, "{i}")
    normals = "".join(f"vn {x - 0.5} {y - 0.5} {z - 0.5}\n" for x, y, z in _CORNERS)
    texture = "vt 0 0\nvt 1 0\nvt 1 1 0\nvt 0 1\n"
    files = {
        "quads": vertices + quads,
        "triangles": vertices + triangles,
        "normals": vertices + normals + _obj_faces(_TRIANGLES, "{i}//{i}"),
        "texture": vertices + texture + _obj_faces(_QUADS, "{i}/{j}"),
        "all": "# made\nmtllib cube.mtl\no cube\n" + vertices + texture + normals + "g side\nusemtl red\ns 1\n"
        + _obj_faces(_QUADS, "{i}/{j}/{i}"),
        "relative": vertices + "f -8 -5 -6 -7\nf -4 -3 -2 -1\n" + vertices + "f -8 -5 -6 -7\n",
        "two objects": "o a\n" + vertices + quads + "o b\n" + vertices.replace("v ", "v 2")
        + _obj_faces([[i + len(_CORNERS) for i in quad] for quad in _QUADS], "{i}"),
        "concave": "v 0 0 0\nv 2 1 0\nv 0 2 0\nv .7 1 0\nf 1 2 3 4\n",
        "colours": "".join(f"v {x} {y} {z} 1 0 .5\n" for x, y, z in _CORNERS) + triangles,
        "weights": "".join(f"v {x} {y} {z} 1.0\n" for x, y, z in _CORNERS) + triangles,
        "curves": vertices + "cstype bezier\ndeg 3\ncurv 0 1 1 2 3 4\nparm u 0 1\nend\nl 1 2\np 1\n" + quads,
        "continued": vertices + "f 1 2 \\\n 3 4\n" + quads,
    }  # fmt: skip
    files["crlf"] = files["all"].replace("\n", "\r\n")
    return [InputFile(name, ".obj", content.encode()) for name, content in files.items()]


def obj_mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change words and lines."""
    return mutated_text(content, rng, others)


def ply_seeds() -> list[InputFile]:
    """Text and both binary orders, of triangles, quads and both, with normals, colours and elements of no use here."""
    files = {}
    mixed = (*_QUADS[:3], *_TRIANGLES[6:])
    for kind in ("ascii", "binary_little_endian", "binary_big_endian"):
        for name, faces in (("triangles", _TRIANGLES), ("quads", _QUADS), ("mixed", mixed)):
            files[f"{kind}, {name}"] = _ply(kind, faces)
        files[f"{kind}, normals"] = _ply(kind, _TRIANGLES, normals=True)
        files[f"{kind}, short lists"] = _ply(kind, _QUADS, count="ushort", index="ushort", coordinate="double")
        files[f"{kind}, signed"] = _ply(kind, _TRIANGLES, count="int", index="uint")
        files[f"{kind}, more"] = _ply(kind, mixed, more=True)
        files[f"{kind}, points"] = _ply(kind, ())
    files["crlf"] = _ply("ascii", _QUADS).replace(b"\n", b"\r\n")
    return [InputFile(name, ".ply", content) for name, content in files.items()]


def ply_mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change words and lines of the header, or what it describes."""
    end = content.index(b"end_header") + len(b"end_header\n")
    header, body = content[:end], content[end:]
    if rng.random() < 0.6:
        return mutated_text(header, rng, others) + body
    ascii_body = b"format ascii" in header and body.split()
    return header + (mutated_text if ascii_body else mutated_bytes)(body, rng, others)


def _obj_faces(faces: Sequence[Sequence[int]], corner: str) -> str:
    """Lines of faces; a corner is written from i, its vertex, and j, its place in the face, both counted from 1."""
    return "".join(f"f {' '.join(corner.format(i=i + 1, j=j + 1) for j, i in enumerate(face))}\n" for face in faces)


def _ply(
    kind: str,
    faces: Sequence[Sequence[int]],
    normals: bool = False,
    more: bool = False,
    count: str = "uchar",
    index: str = "int",
    coordinate: str = "float",
) -> bytes:
    lines = ["ply", f"format {kind} 1.0", "comment made", f"element vertex {len(_CORNERS)}"]
    lines += [f"property {coordinate} {axis}" for axis in "xyz"]
    lines += [f"property float n{axis}" for axis in "xyz"] if normals else []
    lines += [f"property uchar {colour}" for colour in ("red", "green", "blue")] if more else []
    lines += [f"element face {len(faces)}", f"property list {count} {index} vertex_indices"]
    lines += ["property uchar flags", "element edge 1", "property int vertex1", "property int vertex2"] if more else []
    rows: list[list[tuple[str, float]]] = []
    for corner in _CORNERS:
        row: list[tuple[str, float]] = [(coordinate, x) for x in corner]
        row += [("float", x - 0.5) for x in corner] if normals else []
        rows.append(row + ([("uchar", 200)] * 3 if more else []))
    for face in faces:
        row = [(count, len(face)), *((index, i) for i in face)]
        rows.append(row + ([("uchar", 1)] if more else []))
    if more:
        rows.append([("int", 0), ("int", 1)])
    header = "\n".join([*lines, "end_header\n"]).encode()
    if kind == "ascii":
        return header + "".join(" ".join(f"{value:g}" for _, value in row) + "\n" for row in rows).encode()
    order = "<" if kind.endswith("little_endian") else ">"
    return header + b"".join(struct.pack(order + _NUMBERS[number], value) for row in rows for number, value in row)
