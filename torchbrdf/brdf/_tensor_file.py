"""Named arrays in one file: the container of RGL's `.bsdf` files, as Mitsuba 3 and pbrt-v4 read it.

    "tensor_file\\0"  version 1.0  number of fields
    for each field: name, number of axes, type, offset of its values in the file, length of each axis
    the values, C order, little endian

What a header says is compared with the file's length before anything is read: a lying one allocates nothing.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import BinaryIO

import numpy as np

from torchbrdf.brdf.settings import AGAIN
from torchbrdf.files import existing_file, printable

_MAGIC = b"tensor_file\0"
_VERSION = (1, 0)
_TYPES = {
    code: np.dtype(name)
    for code, name in enumerate(("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"), 1)
}
_CODES = {dtype: code for code, dtype in _TYPES.items()}
_ALIGNMENT = 8
_MOST_AXES = 32
"""More NumPy has no arrays of."""


@dataclass(frozen=True)
class _Field:
    dtype: np.dtype
    shape: tuple[int, ...]
    offset: int


class TensorFile:
    """The fields of a file, each read when it is asked for."""

    def __init__(self, path: Path, what: str) -> None:
        """Read and check the header.

        what  the file is, for messages: "an RGL .bsdf file"
        Raises as `existing_file`, and ValueError for a header that is not one or does not fit the file.
        """
        self.path = existing_file(path, what)
        size = path.stat().st_size
        with open(path, "rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise ValueError(f"{path}: not {what}: it does not begin with 'tensor_file'")
            version = self._unpack(file, "<BB")
            if version != _VERSION:
                raise ValueError(f"{path}: a tensor file of version {version[0]}.{version[1]}; only 1.0 is read")
            (count,) = self._unpack(file, "<I")
            self._fields: dict[str, _Field] = {}
            for _ in range(count):
                name, field = self._header(file, size)
                if name in self._fields:
                    raise ValueError(f"{path}: the field {name!r} is there twice; {AGAIN}")
                self._fields[name] = field

    def __contains__(self, name: str) -> bool:
        """Whether there is such a field."""
        return name in self._fields

    def read(self, name: str, dtype: str, axes: int) -> np.ndarray:
        """The values of a field. Raises ValueError where there is none, or it is of another type or number of axes."""
        field = self._fields.get(name)
        if field is None:
            known = ", ".join(self._fields) or "none"
            raise ValueError(f"{self.path}: has no field {name!r}, only {known}; it is no measured material")
        if field.dtype != np.dtype(dtype) or len(field.shape) != axes:
            raise ValueError(
                f"{self.path}: the field {name!r} must be {np.dtype(dtype).name} with {axes} axes, "
                f"got {field.dtype.name} {field.shape}; {AGAIN}"
            )
        values = np.fromfile(self.path, field.dtype, prod(field.shape), offset=field.offset)
        return values.reshape(field.shape)

    def _unpack(self, file: BinaryIO, form: str) -> tuple[int, ...]:
        return struct.unpack(form, self._take(file, struct.calcsize(form)))

    def _take(self, file: BinaryIO, count: int) -> bytes:
        taken = file.read(count)
        if len(taken) != count:
            raise ValueError(f"{self.path}: truncated: it ends within its header; {AGAIN}")
        return taken

    def _header(self, file: BinaryIO, size: int) -> tuple[str, _Field]:
        name = printable(self._take(file, *self._unpack(file, "<H")).decode("utf-8", "backslashreplace"))
        axes, code, offset = self._unpack(file, "<HBQ")
        if axes > _MOST_AXES or code not in _TYPES:
            problem = f"{axes} axes" if axes > _MOST_AXES else f"the unknown type {code}"
            raise ValueError(f"{self.path}: the field {name!r} has {problem}; {AGAIN}")
        shape = self._unpack(file, f"<{axes}Q")
        dtype = _TYPES[code]
        if 0 in shape:
            raise ValueError(f"{self.path}: the field {name!r} of shape {shape} is empty; {AGAIN}")
        if offset + prod(shape) * dtype.itemsize > size:
            raise ValueError(
                f"{self.path}: the field {name!r} of shape {shape} does not fit the file's {size} bytes: it is "
                "truncated, or its header is wrong; download or convert it again"
            )
        return name, _Field(dtype, shape, offset)


def write_tensor_file(path: Path, fields: Mapping[str, np.ndarray]) -> None:
    """Write arrays under their names, in order."""
    offset = len(_MAGIC) + 2 + 4 + sum(2 + len(name.encode()) + 11 + 8 * v.ndim for name, v in fields.items())
    header, blocks = bytearray(_MAGIC + struct.pack("<BBI", *_VERSION, len(fields))), []
    for name, values in fields.items():
        padding = -offset % _ALIGNMENT
        offset += padding
        encoded, dtype = name.encode(), values.dtype.newbyteorder("<")
        header += struct.pack("<H", len(encoded)) + encoded
        header += struct.pack(f"<HBQ{values.ndim}Q", values.ndim, _CODES[dtype], offset, *values.shape)
        blocks.append((padding, np.ascontiguousarray(values, dtype)))
        offset += values.nbytes
    with open(path, "wb") as file:
        file.write(header)
        for padding, values in blocks:
            file.write(bytes(padding))
            values.tofile(file)
