"""Polygons become triangles that cover them once, at whichever corner they begin."""

import numpy as np
import pytest

from torchbrdf.view._polygons import Polygons

DART = [(0, 0), (2, 0), (0.5, 0.5), (0, 2)]
ARROW = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (3, 2), (3, 3), (0, 3)]
STAR = [(np.cos(k * np.pi / 5) * (2 - k % 2 * 1.2), np.sin(k * np.pi / 5) * (2 - k % 2 * 1.2)) for k in range(10)]
COMB = [(0, -1), *((k / 2, 3 * (k % 2)) for k in range(1, 40)), (20, -1)]
WITH_HOLE = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
SQUARE_OF_FIVE = [(0, 0), (0.5, 0), (1, 0), (1, 1), (0, 1)]
CIRCLE = [(np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 4000, endpoint=False)]
SHAPES = {
    "dart": DART, "arrow": ARROW, "star": STAR, "comb": COMB, "with hole": WITH_HOLE, "collinear": SQUARE_OF_FIVE,
    "circle": CIRCLE, "square": [(0, 0), (1, 0), (1, 1), (0, 1)],
}  # fmt: skip
PLANE = np.array([[0.36, 0.48, -0.8], [0.8, -0.6, 0.0]])
NORMAL = np.cross(*PLANE)


def shoelace(points):
    x, y = np.array(points).T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def cut(points, first=0, backwards=False, scale=1.0):
    """Signed areas (T,) and corners (T, 3, 2) of the triangles of one polygon in a tilted plane."""
    order = np.roll(np.arange(len(points)), -first)[:: -1 if backwards else 1]
    vertices = scale * (np.array(points, float) @ PLANE + [7, -3, 2])
    faces, lost = Polygons(vertices, np.array([len(order)]), order).triangles()
    assert lost == 0
    a, b, c = vertices[faces].swapaxes(0, 1)
    return np.cross(b - a, c - a) @ NORMAL / 2 / scale**2, np.array(points)[faces]


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_triangles_have_the_area_of_their_polygon_and_its_sense(shape, backwards, scale):
    areas, _ = cut(SHAPES[shape], backwards=backwards, scale=scale)
    expected = shoelace(SHAPES[shape]) * (-1 if backwards else 1)
    assert areas.sum() == pytest.approx(expected, rel=1e-6)
    assert (np.sign(areas) == np.sign(expected)).all()


@pytest.mark.parametrize("shape", ["dart", "arrow", "star", "comb", "square"])
def test_the_corner_at_which_a_polygon_begins_makes_no_difference(shape):
    found = {
        frozenset(frozenset(map(tuple, triangle.tolist())) for triangle in cut(SHAPES[shape], first)[1])
        for first in range(len(SHAPES[shape]))
    }
    assert len(found) == 1


@pytest.mark.parametrize("first", range(4))
def test_a_bent_square_is_cut_along_its_shorter_diagonal(first):
    vertices = np.array([[0, 0, 0], [1.2, 0, 0.3], [1, 1, 0], [0, 1.2, 0.3]], float)
    faces, _ = Polygons(vertices, np.array([4]), np.roll(np.arange(4), -first)).triangles()
    assert {tuple(sorted(face)) for face in faces.tolist()} == {(0, 1, 2), (0, 2, 3)}


def test_repeated_corners_are_passed_over():
    """As the poles of spheres made of quads have them."""
    areas, _ = cut([(0, 0), (0, 0), (2, 0), (0, 2)])
    assert areas.tolist() == pytest.approx([2])


@pytest.mark.parametrize(
    "points",
    [
        [(0, 0), (1, 1), (1, 0), (0, 1)],
        [(0, 0), (2, 2), (2, 0), (0, 1)],
        STAR[::4] + STAR[2::4],
        [(0, 0), (1, 0), (2, 0), (3, 0)],
        [(0, 0), (1, 0), (1, 0), (0, 0)],
        [(0, 0), (1, 0)],
    ],
    ids=["bow tie", "unequal bow tie", "pentagram", "line", "edge twice", "edge"],
)
def test_polygons_without_inside_are_counted_and_the_others_kept(points):
    vertices = np.array([*points, (5, 5), (6, 5), (5, 6)], float) @ PLANE
    n = len(points)
    faces, lost = Polygons(vertices, np.array([n, 3]), np.arange(n + 3)).triangles()
    assert (faces.tolist(), lost) == ([[n, n + 1, n + 2]], 1)


def test_faces_of_all_lengths_side_by_side():
    shapes = list(SHAPES.values())
    points = np.concatenate([np.array(shape) + np.array([9 * index, 0]) for index, shape in enumerate(shapes)])
    vertices = np.concatenate([points, np.zeros((len(points), 1))], 1)
    faces, lost = Polygons(vertices, np.array([len(shape) for shape in shapes]), np.arange(len(points))).triangles()
    a, b, c = vertices[faces].swapaxes(0, 1)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert lost == 0
    assert np.abs(areas).sum() == pytest.approx(sum(abs(shoelace(shape)) for shape in shapes))
    assert areas.sum() == pytest.approx(sum(map(shoelace, shapes)))


def test_unused_vertices_are_dropped_and_missing_ones_named():
    vertices, normals = np.arange(15.0).reshape(5, 3), np.arange(15.0, 30).reshape(5, 3)
    part = Polygons(vertices, np.array([3]), np.array([4, 0, 2]), normals).compact()
    assert part.vertices.tolist() == vertices[[0, 2, 4]].tolist()
    assert part.vertices[part.corners].tolist() == vertices[[4, 0, 2]].tolist()
    assert part.normals[part.corners].tolist() == normals[[4, 0, 2]].tolist()
    with pytest.raises(ValueError, match="vertex with index 5, of 5"):
        Polygons(vertices, np.array([3]), np.array([0, 1, 5])).compact()
