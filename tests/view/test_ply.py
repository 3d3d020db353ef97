"""Stanford .ply: text and binary, faces of several lengths, other properties, triangle strips."""

import numpy as np
import pytest

from torchbrdf.view._ply import read_ply

FORMATS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, 0)]
KINDS = {"float": "f4", "double": "f8", "uchar": "u1", "int": "i4", "uint": "u4", "short": "i2"}


def ply(file_format, elements, line_end="\n"):
    """A file; elements: name, [property...], rows of (kind, number) and of ((kind, kind), numbers)."""
    header, body, order = [f"ply\nformat {file_format} 1.0\ncomment made by a test"], b"", FORMATS[file_format]
    for name, properties, rows in elements:
        header.append(f"element {name} {len(rows)}")
        for label, kind in properties:
            header.append(f"property {f'list {kind[0]} {kind[1]}' if isinstance(kind, tuple) else kind} {label}")
        for row in rows:
            for (_, kind), value in zip(properties, row, strict=True):
                flat = [(kind, value)]
                if isinstance(kind, tuple):
                    flat = [(kind[0], len(value)), *((kind[1], each) for each in value)]
                for each, number in flat:
                    as_text = f"{number} ".encode()
                    body += as_text if order is None else np.array(number, order + KINDS[each]).tobytes()
            body += b"\n" if order is None else b""
    return (line_end.join("\n".join([*header, "end_header"]).split("\n")) + line_end).encode() + body


def vertex(points=SQUARE):
    return ("vertex", [("x", "float"), ("y", "float"), ("z", "float")], points)


def face(rows, kind=("uchar", "int"), name="vertex_indices"):
    return ("face", [(name, kind)], [(row,) for row in rows])


def faces_of(part):
    return [each.tolist() for each in np.split(part.corners, np.cumsum(part.counts)[:-1])]


every_format = pytest.mark.parametrize("file_format", FORMATS)


@every_format
@pytest.mark.parametrize(
    "rows", [[(0, 1, 2)], [(0, 1, 2), (0, 2, 3)], [(0, 1, 2, 3), (3, 2, 4)], [(0, 1, 2), (0, 1, 2, 3, 4)]]
)
def test_faces_of_one_or_several_lengths(file_format, rows):
    (part,) = read_ply(ply(file_format, [vertex(), face(rows)]))
    assert faces_of(part) == [list(row) for row in rows]
    np.testing.assert_array_equal(part.vertices, SQUARE)


@every_format
@pytest.mark.parametrize("kind", [("uchar", "uint"), ("int", "short"), ("uint", "uchar")])
@pytest.mark.parametrize("name", ["vertex_index", "vertex_indices"])
def test_kinds_and_names_of_indices(file_format, kind, name):
    (part,) = read_ply(ply(file_format, [vertex(), face([(0, 1, 2), (4, 3, 2, 1)], kind, name)]))
    assert faces_of(part) == [[0, 1, 2], [4, 3, 2, 1]]


@every_format
@pytest.mark.parametrize("mixed", [False, True])
def test_other_properties_lists_and_elements_are_passed_over(file_format, mixed):
    last = (2, (0, 3, 2) if not mixed else (0, 1, 2, 3), (0.5,) * 6, 7)
    elements = [
        ("camera", [("view", "float"), ("names", ("uchar", "double"))], [(1.5, (1, 2, 3)), (2.5, ())]),
        ("vertex", [("red", "uchar"), *((axis, "double") for axis in "zyx"), ("s", "float")],
         [(9, z, y, x, 0.25) for x, y, z in SQUARE]),
        ("face", [("flags", "uchar"), ("vertex_indices", ("uchar", "int")), ("texcoord", ("uchar", "float")),
                  ("material", "int")], [(1, (0, 1, 2), (0.25,) * 6, 5), last]),
        ("edge", [("vertex1", "int")], [(3,)]),
    ]  # fmt: skip
    (part,) = read_ply(ply(file_format, elements))
    assert faces_of(part) == [[0, 1, 2], list(last[1])]
    np.testing.assert_array_equal(part.vertices, SQUARE)


@every_format
def test_normals(file_format):
    names = [(name, "float") for name in ("x", "y", "z", "nx", "ny", "nz")]
    rows = [(*point, 0, 0.5, 1) for point in SQUARE]
    (part,) = read_ply(ply(file_format, [("vertex", names, rows), face([(0, 1, 2)])]))
    np.testing.assert_array_equal(part.normals, [[0, 0.5, 1]] * 5)


@every_format
def test_vertices_whose_rows_have_several_lengths(file_format):
    names = [("owners", ("uchar", "int")), ("x", "float"), ("y", "float"), ("z", "float")]
    rows = [((1,) * index, *point) for index, point in enumerate(SQUARE)]
    (part,) = read_ply(ply(file_format, [("vertex", names, rows), face([(0, 1, 2)])]))
    np.testing.assert_array_equal(part.vertices, SQUARE)


@every_format
def test_triangle_strips(file_format):
    """Every other triangle is turned round; -1 begins a new strip."""
    strips = ("tristrips", [("vertex_indices", ("int", "int"))], [((0, 1, 2, 3, -1, 4, 3, 2),), ((1, 0, 4),)])
    (part,) = read_ply(ply(file_format, [vertex(), strips]))
    assert faces_of(part) == [[0, 1, 2], [2, 1, 3], [4, 3, 2], [1, 0, 4]]


@every_format
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_line_ends_of_the_header(file_format, line_end):
    points = [(float(np.frombuffer(b"\n\n\n\n", "<f4")[0]), 0, 0), *SQUARE[1:]]  # the first byte looks like a line end
    (part,) = read_ply(ply(file_format, [vertex(points), face([(0, 1, 2)])], line_end))
    np.testing.assert_allclose(part.vertices, points, rtol=1e-6)


@every_format
@pytest.mark.parametrize("rows", [[(0, 1, 2)] * 9, [(0, 1, 2), (0, 1, 2, 3)] * 5])
@pytest.mark.parametrize("lost", [1, 7, 30])
def test_truncated_files_are_named(file_format, rows, lost):
    content = ply(file_format, [vertex(), face(rows)])
    with pytest.raises(ValueError, match="has fewer; is it truncated"):
        read_ply(content.rstrip()[:-lost - 2])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"ply\n", b"plx\n", "does not begin with a header"),
        (b"format ascii 1.0", b"format ebcdic 1.0", "line 'format ebcdic 1.0'"),
        (b"property float x", b"property quad x", "line 'property quad x'"),
        (b"property float x", b"property float u", "need the properties x, y and z"),
        (b"list uchar", b"list float", "line 'property list float int vertex_indices'"),
        (b"vertex_indices", b"corners", "no property list vertex_indices or vertex_index"),
        (b"\n3 ", b"\n-3 ", "face has the length -3"),
        (b"\n3 ", b"\n2.5 ", "face has the length 2.5"),
        (b"0 1 2 \n", b"0 1 1.5 \n", "no whole number"),
        (b"element vertex 5", b"element vertex many", "line 'element vertex many'"),
    ],
)
def test_damaged_files_are_named(old, new, message):
    content = ply("ascii", [vertex(), face([(0, 1, 2)])])
    assert old in content
    with pytest.raises(ValueError, match=message):
        read_ply(content.replace(old, new))
