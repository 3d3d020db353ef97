"""Wavefront .obj: indices, line ends, polygons."""

import numpy as np
import pytest

from torchbrdf.view._obj import read_obj

SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def one(content):
    """The only part that has faces."""
    (part,) = (part for part in read_obj(content) if len(part.counts))
    return part.compact()


def corners(content):
    part = one(content)
    return part.vertices[part.corners].tolist()


def test_relative_indices_count_from_the_line_on_which_they_stand():
    second = b"v 5 0 0\nv 6 0 0\nv 6 1 0\nv 5 1 0\n"
    content = SQUARE + b"f -4 -3 -2 -1\n" + second + b"f -4 -3 -2 -1\n"
    assert corners(content) == corners(SQUARE + second + b"f 1 2 3 4\nf 5 6 7 8\n")


def test_relative_normals_count_normals_and_not_vertices():
    content = SQUARE + b"vn 1 0 0\nvn 0 1 0\nf 1//-2 2//-2 3//-1\nvn 0 0 1\nf 1//-1 3//-1 4//-1\n"
    part = one(content)
    expected = [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 0, 1]]
    assert part.normals[part.corners].tolist() == expected


def test_relative_texture_indices_disturb_nothing():
    content = SQUARE + b"vt 0 0\nvt 1 0\nvn 0 0 1\nf -4/-2/-1 -3/-1/-1 -2/-1/-1\n"
    assert corners(content) == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]


@pytest.mark.parametrize(
    "face",
    [
        b"f 1 2 3 4", b"f\t1\t2\t3\t4", b"  f  1  2  3  4  ", b"f 1 2 3 4 # a square", b"f 1 2 \\\n3 4",
        b"f 1/1 2/1 3/1 4/1", b"f 1/1 2 3/1 4", b"f 1/ 2/ 3/ 4/", b"f -4 2 -2 4", b"g a b\nusemtl C:\\\nf 1 2 3 4",
    ],
)  # fmt: skip
@pytest.mark.parametrize("line_end", [b"\n", b"\r\n", b"\r"])
def test_ways_to_write_a_face(face, line_end):
    content = (SQUARE + b"vt 0 0\n" + face + b"\n").replace(b"\n", line_end)
    assert corners(content) == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


def test_a_comment_or_name_that_ends_in_a_backslash_swallows_no_line():
    assert len(corners(b"# C:\\shapes\\\n" + SQUARE + b"mtllib C:\\x\\\nf 1 2 3\n")) == 3


@pytest.mark.parametrize("behind", [b"1", b"0.5 0.25 1", b"0.5 0.25 1 1"])
def test_weights_and_colours_behind_a_vertex(behind):
    content = b"v 0 0 0 " + behind + b"\nv 1 0 0\nv 1 1 0 " + behind + b"\nf 1 2 3\n"
    assert corners(content) == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]


def test_a_vertex_with_two_normals_becomes_two():
    part = one(SQUARE + b"vn 1 0 0\nvn 0 1 0\nf 1//1 2//1 3//1\nf 1//2 3//2 4//2\n")
    assert len(part.vertices) == 6
    np.testing.assert_array_equal(part.normals[part.corners], [[1, 0, 0]] * 3 + [[0, 1, 0]] * 3)


def test_faces_with_and_without_normals_are_kept_apart():
    bare, smooth = read_obj(SQUARE + b"vn 0 0 1\nf 1 2 3\nf 1//1 3//1 4//1\nf 1//1 2//1 3\n")
    assert (bare.counts.tolist(), smooth.counts.tolist()) == ([3, 3], [3])
    assert bare.normals is None


def test_a_long_file_is_read_in_blocks(monkeypatch):
    content = b"".join(SQUARE.replace(b"0\n", b"%d\n" % z) + b"f -4 -3 -2 -1\n" for z in range(50))
    whole = corners(content)
    monkeypatch.setattr("torchbrdf.view._obj._BLOCK", 100)
    assert corners(content) == whole
    assert whole[-1] == [0, 1, 49]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"f 1 2 5", "vertex with index 5, of 4"),
        (b"f 1 2 -5", "vertex with index -5, of 4 before it"),
        (b"f 0 1 2", "index 0, but .obj files count from 1"),
        (b"f 1//1 2//1 3//1", "normal with index 1, of 0"),
        (b"f 1//-1 2//-1 3//-1", "normal with index -1, of 0 before it"),
        (b"f 1 2 x", "corners such as 1, 1/1.*got 'x'"),
        (b"f 1 2 3.5", "got '3.5'"),
        (b"f 1/1/1/1 2/1/1/1 3/1/1/1", "got '1/1/1/1'"),
        (b"f 1 2 99999999999999999999", "index 9223372036854775807, of 4"),
        (b"v 1 2", "line 'v' needs three numbers, got '1 2'"),
        (b"v 1 2 1,5", "line 'v' needs three numbers, got '1 2 1,5'"),
    ],
)
def test_damaged_lines_are_named(line, message):
    with pytest.raises(ValueError, match=message):
        read_obj(SQUARE + line + b"\nf 1 2 3\n")
