"""Stanford .ply files, as text or binary in either order of bytes: vertices, normals, faces and triangle strips."""

import re
from array import array
from dataclasses import dataclass
from struct import Struct

import numpy as np

from torchbrdf.view._numbers import numbers
from torchbrdf.view._polygons import Polygons

_KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER = 1 << 16
_INDICES = ("vertex_indices", "vertex_index")


def read_ply(content: bytes) -> list[Polygons]:
    """The faces and triangle strips; raises ValueError where the file is damaged, or shorter than its header says."""
    byte_order, elements, body = _header(content)
    rows = _Rows(body, byte_order)
    vertices = normals = None
    faces = [(np.empty(0, np.int64), np.empty(0, np.int64))]
    for element in elements:
        table = rows.next(element)
        if element.name == "vertex":
            vertices = table.columns("x", "y", "z")
            normals = table.columns("nx", "ny", "nz")
            if vertices is None:
                raise ValueError("the vertices need the properties x, y and z")
        elif element.name in ("face", "tristrips") and element.count:
            more = table.indices()
            if more is None:
                raise ValueError(f"the element {element.name} has no property list {' or '.join(_INDICES)}")
            faces.append(_unrolled(*more) if element.name == "tristrips" else more)
    if vertices is None:
        raise ValueError("it has no element vertex")
    counts, corners = (np.concatenate(parts) for parts in zip(*faces, strict=True))
    return [Polygons(vertices, counts, corners, normals)]


@dataclass(frozen=True)
class _Property:
    """A number of a row, or a list of numbers; kinds are NumPy's without the order of bytes."""

    name: str
    kind: str
    count_kind: str | None = None


@dataclass(frozen=True)
class _Element:
    """Rows of the same properties."""

    name: str
    count: int
    properties: list[_Property]

    @property
    def promise(self) -> str:
        plural = "vertices" if self.name == "vertex" else f"{self.name.removesuffix('s')}s"
        return f"the header promises {self.count} {plural} and the file has fewer; is it truncated?"


def _header(content: bytes) -> tuple[str, list[_Element], memoryview]:
    end = re.compile(rb"(?:\A|[\r\n])end_header[ \t]*(\r\n|\r|\n|\Z)").search(content, 0, _MAX_HEADER)
    if not content.startswith(b"ply") or end is None:
        raise ValueError("it does not begin with a header, 'ply' to 'end_header'")
    byte_order: str | None = None
    elements: list[_Element] = []
    for line in content[: end.start()].splitlines()[1:]:
        words = line.decode("ascii", "replace").split()
        try:
            match words:
                case ["format", format_name, "1.0"] if format_name in _FORMATS:
                    byte_order = _FORMATS[format_name]
                case ["element", name, count] if count.isdecimal() and len(count) < 16:
                    elements.append(_Element(name, int(count), []))
                case ["property", "list", count_kind, kind, name] if _KINDS[count_kind][0] != "f":
                    elements[-1].properties.append(_Property(name, _KINDS[kind], _KINDS[count_kind]))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _KINDS[kind]))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise LookupError
        except LookupError:
            raise ValueError(f"its header has the line {' '.join(words)[:60]!r}") from None
    if byte_order is None:
        raise ValueError("its header names no format")
    if end[1] == b"\r\n" and byte_order and not content.startswith(b"ply\r\n"):
        return byte_order, elements, memoryview(content)[end.end() - 1 :]  # the line feed belongs to the numbers
    return byte_order, elements, memoryview(content)[end.end() :]


@dataclass(frozen=True)
class _Table:
    """The rows of an element: columns (N,) by name, and lists, their lengths (N,) and all of their numbers."""

    single: dict[str, np.ndarray]
    listed: dict[str, tuple[np.ndarray, np.ndarray]]

    def columns(self, *names: str) -> np.ndarray | None:
        """(N, len(names)) float64; None where one is missing."""
        if not set(names) <= set(self.single):
            return None
        return np.stack([self.single[name] for name in names], -1).astype(np.float64)

    def indices(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Lengths and numbers, int64, of the list of vertices; None where there is none."""
        for name in _INDICES:
            if name in self.listed:
                lengths, found = self.listed[name]
                whole = np.where(np.abs(found) < 1e15, found, np.nan) if found.dtype.kind == "f" else found
                if found.dtype.kind == "f" and not (whole == np.floor(whole)).all():
                    raise ValueError(f"{name} holds an index that is no whole number")
                return lengths, whole.astype(np.int64)
        return None


class _Rows:
    """Elements one behind the other. Text becomes numbers first, all of one kind, and is then read like binary."""

    def __init__(self, body: memoryview, byte_order: str) -> None:
        self._kinds = {kind: np.dtype(byte_order + kind) for kind in _KINDS.values()}
        if not byte_order:
            body = memoryview(numbers(bytes(body), np.float64).tobytes())
            self._kinds = dict.fromkeys(self._kinds, np.dtype(np.float64))
        self._body = body
        self._at = 0

    def next(self, element: _Element) -> _Table:
        """The following rows; raises ValueError where the file ends before them."""
        if not element.count or not element.properties:
            return _Table({}, {})
        return self._even(element) or self._ragged(element)

    def _even(self, element: _Element) -> _Table | None:
        """Rows whose lists are as long as those of the first; None where they are not."""
        starts, lengths, end = self._walk(element, 1)
        width = end - self._at
        if self._at + element.count * width > len(self._body):
            if not any(lengths):
                raise ValueError(element.promise)
            return None
        table = _Table({}, {})
        for each, (start,), length in zip(element.properties, starts, lengths, strict=True):
            if each.count_kind is None:
                table.single[each.name] = self._strided(each.kind, start, (element.count,), (width,))
                continue
            counter, item = self._kinds[each.count_kind].itemsize, self._kinds[each.kind].itemsize
            (n,) = length
            if (self._strided(each.count_kind, start - counter, (element.count,), (width,)) != n).any():
                return None
            found = self._strided(each.kind, start, (element.count, n), (width, item))
            table.listed[each.name] = np.full(element.count, n), found.ravel()
        self._at += element.count * width
        return table

    def _ragged(self, element: _Element) -> _Table:
        starts, lengths, self._at = self._walk(element, element.count)
        table = _Table({}, {})
        for each, start, length in zip(element.properties, starts, lengths, strict=True):
            places, kind = np.array(start), self._kinds[each.kind]
            if each.count_kind is not None:
                counts = np.array(length)
                within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
                places = np.repeat(places, counts) + kind.itemsize * within
            anywhere = self._strided(each.kind, 0, (max(len(self._body) - kind.itemsize + 1, 0),), (1,))
            if each.count_kind is None:
                table.single[each.name] = anywhere[places]
            else:
                table.listed[each.name] = counts, anywhere[places]
        return table

    def _walk(self, element: _Element, n_rows: int) -> tuple[list[array], list[array], int]:
        """Where the numbers of each property begin, row by row, how many are in each list, and where the rows end."""
        starts, lengths = ([array("q") for _ in element.properties] for _ in range(2))
        steps = []
        for each, start, length in zip(element.properties, starts, lengths, strict=True):
            unpack, counter_size = None, 0
            if each.count_kind is not None:
                counter = self._kinds[each.count_kind]
                unpack = Struct(counter.byteorder.replace("|", "<") + counter.char).unpack_from
                counter_size = counter.itemsize
            steps.append((unpack, counter_size, self._kinds[each.kind].itemsize, start, length))
        at, end = self._at, len(self._body)
        for _ in range(n_rows):
            for unpack, counter_size, size, start, length in steps:
                n = 1
                if unpack is not None:
                    if at + counter_size > end:
                        raise ValueError(element.promise)
                    (found,) = unpack(self._body, at)
                    if not 0 <= found < 1 << 32 or found != (n := int(found)):
                        raise ValueError(f"a list of the element {element.name} has the length {found}")
                    length.append(n)
                    at += counter_size
                start.append(at)
                at += n * size
            if at > end:
                raise ValueError(element.promise)
        return starts, lengths, at

    def _strided(self, kind: str, at: int, shape: tuple[int, ...], strides: tuple[int, ...]) -> np.ndarray:
        return np.ndarray(shape, self._kinds[kind], self._body, at, strides)


def _unrolled(lengths: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of strips (lengths and corners), in which -1 begins a new one; every other triangle is turned round."""
    n = len(corners)
    begins = np.zeros(n, bool)
    begins[(np.cumsum(lengths) - lengths)[lengths > 0]] = True
    begins[1:] |= corners[:-1] < 0
    place = np.arange(n) - np.maximum.accumulate(np.where(begins, np.arange(n), 0)) if n else corners
    third = np.flatnonzero((place >= 2) & (corners >= 0))
    odd = place[third] % 2
    triangles = np.stack([corners[third - 2 + odd], corners[third - 1 - odd], corners[third]], axis=1)
    return np.full(len(third), 3), triangles.ravel()
