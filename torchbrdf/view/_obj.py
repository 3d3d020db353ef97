"""Wavefront .obj files: vertices, normals and faces; everything else in them is passed over."""

import re
from collections.abc import Iterator, Sequence

import numpy as np

from torchbrdf.view._numbers import numbers
from torchbrdf.view._polygons import Polygons

_BLOCK = 1 << 22
"""Bytes that are taken apart at once: lines and words need several times the memory of the file."""

_CONTINUED = re.compile(rb"(?<![^\r\n])[ ]*(?:vn?|f)[ ][^\\\r\n]*(?:\\[ ]*(?:\r\n?|\n)[^\\\r\n]*)+")
_LINE_END = re.compile(rb"\\[ ]*(?:\r\n?|\n)")


def read_obj(content: bytes) -> list[Polygons]:
    """The faces with a normal at every corner, and those without.

    Relative indices count back from the line on which they stand. Raises ValueError where a line is damaged.
    """
    found = _Found()
    if b"\\" in content:
        spaced = content.replace(b"\t", b" ")
        content = _CONTINUED.sub(lambda line: _LINE_END.sub(b" ", line[0]), spaced)
    for lines in _blocks(content):
        found.add(lines)
    return found.polygons()


def _blocks(content: bytes) -> Iterator[list[bytes]]:
    start = 0
    while start < len(content):
        end = content.find(b"\n", start + _BLOCK)
        end = len(content) if end < 0 else end + 1
        yield content[start:end].replace(b"\t", b" ").splitlines()
        start = end


class _Found:
    """What the lines so far hold."""

    def __init__(self) -> None:
        self.n_vertices = self.n_normals = 0
        self.vertices: list[np.ndarray] = []
        self.normals: list[np.ndarray] = []
        self.counts: list[np.ndarray] = []
        self.corners: list[np.ndarray] = []
        """(2, C) int64 each: vertices, and normals or -1, both counted from 0."""

    def add(self, lines: list[bytes]) -> None:
        vertices: list[bytes] = []
        normals: list[bytes] = []
        faces: list[bytes] = []
        relative: list[tuple[int, int, int]] = []
        for line in lines:
            if b"#" in line:
                line = line.partition(b"#")[0]
            key, _, rest = line.partition(b" ")
            if not key:
                key, _, rest = line.lstrip().partition(b" ")
            if key == b"v":
                vertices.append(rest)
            elif key == b"f":
                if b"-" in rest:
                    relative.append((len(faces), self.n_vertices + len(vertices), self.n_normals + len(normals)))
                faces.append(rest)
            elif key == b"vn":
                normals.append(rest)
        self.vertices.append(_triples(vertices, "v"))
        self.normals.append(_triples(normals, "vn"))
        self.n_vertices += len(vertices)
        self.n_normals += len(normals)
        if faces:
            counts = np.fromiter(map(len, map(bytes.split, faces)), np.int64, len(faces))
            self.counts.append(counts)
            self.corners.append(_absolute(_fields(faces, int(counts.sum())), counts, relative))

    def polygons(self) -> list[Polygons]:
        if not self.counts:
            return []
        vertices, all_normals = np.concatenate(self.vertices), np.concatenate(self.normals)
        counts, (corners, normals) = np.concatenate(self.counts), np.concatenate(self.corners, axis=1)
        for what, used, n in (("vertex", corners, self.n_vertices), ("normal", normals, self.n_normals)):
            if used.max(initial=-1) >= n:
                raise ValueError(f"a face names the {what} with index {used.max() + 1}, of {n}")
        lacking = np.repeat(np.arange(len(counts)), counts)[normals < 0]
        smooth = np.bincount(lacking, minlength=len(counts)) == 0
        at_corner = np.repeat(smooth, counts)
        parts = [Polygons(vertices, counts[~smooth], corners[~at_corner])]
        counts, corners, normals = counts[smooth], corners[at_corner], normals[at_corner]
        if np.array_equal(corners, normals) and self.n_normals == self.n_vertices:
            return [*parts, Polygons(vertices, counts, corners, all_normals)]
        pairs, corners = np.unique(corners * max(self.n_normals, 1) + normals, return_inverse=True)
        at, normal = np.divmod(pairs, max(self.n_normals, 1))
        return [*parts, Polygons(vertices[at], counts, corners, all_normals[normal])]


def _triples(lines: Sequence[bytes], key: str) -> np.ndarray:
    """(N, 3) float64: the first three numbers of each line."""
    widths = set(map(len, map(bytes.split, lines)))
    if min(widths, default=3) < 3:
        raise ValueError(f"a line {key!r} needs three numbers, got {_shown(min(lines, key=lambda x: len(x.split())))}")
    if widths - {3}:
        lines = [b" ".join(line.split(None, 3)[:3]) for line in lines]
    found = numbers(b" ".join(lines), np.float64)
    if len(found) != 3 * len(lines):
        raise ValueError(f"a line {key!r} needs three numbers, got {_shown(lines[len(found) // 3])}")
    return found.reshape(-1, 3)


def _fields(faces: list[bytes], n_corners: int) -> np.ndarray:
    """(2, C) int64: vertex and normal of every corner as written, the normal 0 where there is none."""
    text = b" ".join(faces)
    words = text.split()
    slashes = set(map(_slashes, words))
    if slashes == {0}:
        found = numbers(text, np.int64)
        if len(found) == n_corners:
            return np.stack([found, np.zeros_like(found)])
    elif len(slashes) == 1 and slashes <= {1, 2}:
        flat = numbers(text.replace(b"//", b"/0/").replace(b"/", b" "), np.int64)
        if len(flat) == n_corners * (1 + slashes.pop()):
            table = flat.reshape(n_corners, -1).T
            return np.stack([table[0], table[2] if len(table) == 3 else np.zeros_like(table[0])])
    return np.array([_corner(word) for word in words], np.int64).reshape(-1, 2).T


def _slashes(word: bytes) -> int:
    return word.count(b"/")


def _corner(word: bytes) -> tuple[int, int]:
    parts = word.split(b"/")
    try:
        normal = int(parts[2]) if len(parts) == 3 and parts[2] else 0
        if len(parts) > 3 or max(abs(int(parts[0])), abs(normal)) >= 1 << 62:
            raise ValueError
        return int(parts[0]), normal
    except ValueError:
        raise ValueError(f"a face needs corners such as 1, 1/1, 1/1/1 or 1//1, got {_shown(word)}") from None


def _absolute(fields: np.ndarray, counts: np.ndarray, relative: list[tuple[int, int, int]]) -> np.ndarray:
    """Indices counted from 0; relative: faces with negative ones, and the vertices and normals before each."""
    vertices, normals = fields
    if not vertices.all():
        raise ValueError("a face names the vertex with index 0, but .obj files count from 1")
    before = np.zeros((2, len(counts)), np.int64)
    for face, *present in relative:
        before[:, face] = present
    before = np.repeat(before, counts, axis=1)
    found = fields - 1
    negative = fields < 0
    found[negative] += before[negative] + 1
    for what, written, row in (("vertex", vertices, 0), ("normal", normals, 1)):
        beyond = negative[row] & (found[row] < 0)
        if beyond.any():
            at = int(beyond.argmax())
            raise ValueError(f"a face names the {what} with index {written[at]}, of {before[row, at]} before it")
    return found


def _shown(text: bytes) -> str:
    return repr(text.strip()[:60].decode("utf-8", "replace"))
