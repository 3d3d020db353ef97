"""`TriangleMesh`: what .ply and .obj files give, and one clear line for those that are no sound mesh."""

import re
import resource
import subprocess
import sys
import warnings

import numpy as np
import pytest

pytest.importorskip("trimesh", reason="trimesh is not installed")

import trimesh

from torchbrdf.view.mesh import TriangleMesh

HEADER = (
    "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
)
CORNERS = ["0 0 0", "1 0 0", "0 1 0", "1 1 0", "0.5 0 0"]
OBJ = "".join(f"v {corner}\n" for corner in CORNERS)


def ply(faces, corners=CORNERS, vertices=None, n_faces=None):
    """An ASCII .ply; the header may lie."""
    n_vertices = len(corners) if vertices is None else vertices
    header = HEADER.format(format="ascii", vertices=n_vertices, faces=len(faces) if n_faces is None else n_faces)
    return (header + "\n".join([*corners, *(f"{len(face.split())} {face}" for face in faces)]) + "\n").encode()


def binary_ply(faces, vertices=None, n_faces=None, order="little", corners=CORNERS):
    """The same, binary."""
    sign = "<" if order == "little" else ">"
    header = HEADER.format(
        format=f"binary_{order}_endian",
        vertices=len(corners) if vertices is None else vertices,
        faces=len(faces) if n_faces is None else n_faces,
    )
    body = np.array([corner.split() for corner in corners], dtype=float).astype(f"{sign}f4").tobytes()
    for face in faces:
        indices = [int(index) for index in face.split()]
        body += bytes([len(indices)]) + np.array(indices, f"{sign}i4").tobytes()
    return header.encode() + body


def opened(path):
    """The mesh and the messages of its warnings, all of them our own."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = TriangleMesh.open(path)
    assert all(warning.category is UserWarning for warning in caught), [str(w.message) for w in caught]
    return mesh, [str(warning.message) for warning in caught]


def refused(path, error=ValueError):
    """The one line that a file is refused with; it names the file, and no library warns or logs."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(error) as caught:
            TriangleMesh.open(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


def written(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# Sound files


@pytest.mark.parametrize("make", [ply, binary_ply, lambda faces: binary_ply(faces, order="big")])
def test_a_ply_file(tmp_path, make):
    mesh, messages = opened(written(tmp_path, "sheet.ply", make(["0 1 2", "1 3 2"])))
    assert mesh.name == "sheet"
    assert len(mesh.faces) == 2
    np.testing.assert_allclose(sorted(mesh.vertices[mesh.faces[0]].tolist()), [[0, 0, 0], [0, 1, 0], [1, 0, 0]])
    np.testing.assert_allclose(mesh.normals[np.unique(mesh.faces)], np.broadcast_to([0, 0, 1], (4, 3)), atol=1e-6)
    assert len(messages) == 1
    assert "sheet.ply: has no vertex normals" in messages[0]


@pytest.mark.parametrize("suffix", ["ply", "obj", "PLY", "OBJ"])
@pytest.mark.parametrize("corners", ["0 1 3 2", "0 4 1 3 2"])
def test_faces_of_many_corners_are_cut_into_triangles(tmp_path, suffix, corners):
    one_based = " ".join(str(int(corner) + 1) for corner in corners.split())
    content = ply([corners]) if suffix.lower() == "ply" else OBJ + f"f {one_based}\n"
    mesh, _ = opened(written(tmp_path, f"square.{suffix}", content))
    triangles = mesh.vertices[mesh.faces].astype(float)
    areas = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])[:, 2] / 2
    assert areas.sum() == pytest.approx(1)
    assert (areas > 0).all()


@pytest.mark.parametrize("normals", ["", "//1"])
def test_an_obj_file_of_several_groups(tmp_path, normals):
    tilted = "vn 0.6 0 0.8\n" if normals else ""
    faces = (f"f 1{normals} 2{normals} 3{normals}\n", f"f 2{normals} 4{normals} 3{normals}\n")
    text = f"mtllib absent.mtl\n{OBJ}{tilted}o a\ng one\nusemtl x\n{faces[0]}o b\ng two\nusemtl y\ns 1\n{faces[1]}"
    mesh, messages = opened(written(tmp_path, "groups.obj", text))
    assert len(mesh.faces) == 2
    assert {tuple(corner) for corner in mesh.vertices[mesh.faces].reshape(-1, 3).tolist()} == {
        (0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)
    }
    expected = [0.6, 0, 0.8] if normals else [0, 0, 1]
    used = mesh.normals[np.unique(mesh.faces)]
    np.testing.assert_allclose(used, np.broadcast_to(expected, used.shape), atol=1e-6)
    assert len(messages) == (0 if normals else 1)


def test_indices_that_count_from_the_end_of_an_obj_file(tmp_path):
    mesh, _ = opened(written(tmp_path, "relative.obj", OBJ + "f -5 -4 -3\n"))
    assert sorted(mesh.vertices[mesh.faces[0]].tolist()) == [[0, 0, 0], [0, 1, 0], [1, 0, 0]]


def test_normals_of_a_file_are_kept_without_a_warning(tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    bent = sphere.vertices + 0.1 * sphere.vertices[:, ::-1]
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    sphere = trimesh.Trimesh(sphere.vertices, sphere.faces, vertex_normals=bent, process=False)
    path = written(tmp_path, "s.ply", trimesh.exchange.ply.export_ply(sphere, vertex_normal=True))
    mesh, messages = opened(path)
    assert not messages
    np.testing.assert_allclose(mesh.normals, bent, atol=1e-6)
    mesh.save(tmp_path / "again.ply")
    again, messages = opened(tmp_path / "again.ply")
    assert not messages
    for one, other in ((mesh.vertices, again.vertices), (mesh.normals, again.normals), (mesh.faces, again.faces)):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_missing_normals_are_smooth_on_a_sphere_and_not_on_a_cube(tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=3)
    path = written(tmp_path, "sphere.ply", trimesh.exchange.ply.export_ply(sphere, vertex_normal=False))
    mesh, messages = opened(path)
    assert messages == [f"{path}: has no vertex normals; smooth ones were computed from its faces"]
    assert len(mesh.vertices) == len(sphere.vertices)
    assert ((mesh.normals * mesh.vertices).sum(1) > 0.999).all()

    box = trimesh.creation.box()
    path = written(tmp_path, "box.ply", trimesh.exchange.ply.export_ply(box, vertex_normal=False))
    mesh, _ = opened(path)
    assert np.allclose(np.abs(mesh.normals).max(1), 1, atol=1e-5)
    facing = np.cross(*(mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[:, 0]] for k in (1, 2)))
    assert (np.einsum("fi,fki->fk", facing, mesh.normals[mesh.faces]) > 0).all()


def test_a_sheet_with_two_sides_keeps_the_normals_of_both(tmp_path):
    """The same corners in both orders, as many programs export sheets: the normals must not cancel."""
    mesh, _ = opened(written(tmp_path, "sheet.obj", OBJ + "f 1 2 3\nf 1 3 2\nf 2 4 3\n"))
    facing = np.cross(*(mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[:, 0]] for k in (1, 2)))
    np.testing.assert_allclose(mesh.normals[mesh.faces], np.broadcast_to(facing[:, None], (3, 3, 3)), atol=1e-6)


@pytest.mark.parametrize("vn", ["0 0 0", "nan 0 0", "0 0 5e-3"])
def test_unsound_normals_are_computed_anew(tmp_path, vn):
    mesh, messages = opened(written(tmp_path, "sheet.obj", f"{OBJ}vn {vn}\nf 1//1 2//1 3//1\n"))
    assert len(messages) == 1
    np.testing.assert_allclose(mesh.normals[np.unique(mesh.faces)], np.broadcast_to([0, 0, 1], (3, 3)), atol=1e-6)


@pytest.mark.parametrize("name", ["some.ply", "some.obj"])
def test_some_degenerate_triangles_are_left_out_with_their_count(tmp_path, name):
    content = OBJ + "f 1 2 3\nf 1 2 5\nf 1 1 3\nf 2 4 3\n"
    if name.endswith("ply"):
        content = ply(["0 1 2", "0 1 4", "0 0 2", "1 3 2"])
    path = written(tmp_path, name, content)
    mesh, messages = opened(path)
    assert len(mesh.faces) == 2
    assert any(message.startswith(f"{path}: left out 2 of 4 triangles") for message in messages), messages


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_unit_of_length_does_not_matter(tmp_path, scale):
    corners = [" ".join(str(scale * float(x)) for x in corner.split()) for corner in CORNERS]
    mesh, _ = opened(written(tmp_path, "sheet.ply", ply(["0 1 2", "1 3 2"], corners)))
    assert len(mesh.faces) == 2
    assert mesh.radius == pytest.approx(scale / 2**0.5, rel=1e-5)


def test_a_concave_face_has_its_area_in_every_format(tmp_path):
    """A dart of area 1.3, begun at every corner."""
    dart = ["0 0 0", "2 0 0", "0.65 0.65 0", "0 2 0"]
    vertices = "".join(f"v {corner}\n" for corner in dart)
    for first in range(4):
        order = [(first + k) % 4 for k in range(4)]
        face = " ".join(map(str, order))
        paths = [
            written(tmp_path, "dart.obj", vertices + "f " + " ".join(str(k + 1) for k in order)),
            written(tmp_path, "dart.ply", ply([face], dart)),
            written(tmp_path, "big.ply", binary_ply([face], order="big", corners=dart)),
        ]
        for path in paths:
            triangles = opened(path)[0].vertices.astype(float)[opened(path)[0].faces]
            areas = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])[:, 2] / 2
            assert areas.sum() == pytest.approx(1.3)
            assert (areas > 0).all()


def test_faces_that_cross_themselves_are_left_out_with_their_count(tmp_path):
    path = written(tmp_path, "bow.obj", OBJ + "f 1 2 3 4\nf 1 2 3\n")
    mesh, messages = opened(path)
    assert len(mesh.faces) == 1
    assert messages[0].startswith(f"{path}: left out 1 face that has no area")
    path = written(tmp_path, "bow.obj", OBJ + "f 1 2 3 4\n")
    assert "the only face has no area, fewer than three corners, or crosses itself" in refused(path)


def test_vertices_of_no_face_do_not_move_the_frame(tmp_path):
    mesh, _ = opened(written(tmp_path, "sheet.ply", ply(["0 1 2"], [*CORNERS, "90 0 0"])))
    np.testing.assert_allclose(mesh.centre, [0.5, 0.5, 0])


def test_a_glb_file_is_the_same_mesh(tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    sphere = trimesh.Trimesh(sphere.vertices, sphere.faces, vertex_normals=sphere.vertices, process=False)
    scene = trimesh.Scene()
    scene.add_geometry(sphere, transform=trimesh.transformations.translation_matrix([1, 2, 3]))
    path = written(tmp_path, "s.glb", trimesh.exchange.gltf.export_glb(scene, include_normals=True))
    mesh, messages = opened(path)
    assert not messages
    np.testing.assert_allclose(mesh.vertices, sphere.vertices + np.array([1, 2, 3]), atol=1e-6)
    np.testing.assert_allclose(mesh.normals, sphere.vertices, atol=1e-6)


# Bad files


def png():
    cv2 = pytest.importorskip("cv2")
    noise = np.random.default_rng(0).integers(0, 255, (32, 32, 3), dtype=np.uint8)
    return cv2.imencode(".png", noise)[1].tobytes()


@pytest.mark.parametrize("suffix", ["ply", "obj"])
@pytest.mark.parametrize("what", ["text", "random bytes", "png", "empty", "zeros"])
def test_not_a_mesh(tmp_path, suffix, what):
    content = {
        "text": b"The quick brown fox\njumps over the lazy dog.\n",
        "random bytes": np.random.default_rng(1).bytes(4000),
        "empty": b"",
        "zeros": bytes(4000),
    }
    path = written(tmp_path, f"no.{suffix}", png() if what == "png" else content[what])
    assert re.search("mesh|no faces", refused(path))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cloud.ply", ply([])),
        ("cloud.ply", binary_ply([])),
        ("cloud.ply", ply([]).replace(b"element face 0\nproperty list uchar int vertex_indices\n", b"")),
        ("cloud.obj", OBJ),
        ("lines.obj", OBJ + "l 1 2\nl 2 3\n"),
    ],
)
def test_no_faces(tmp_path, name, content):
    assert "no faces" in refused(written(tmp_path, name, content))


@pytest.mark.parametrize(
    ("name", "content"), [("d.ply", ply(["0 1 4", "0 0 2"])), ("d.obj", OBJ + "f 1 2 5\nf 1 1 3\n")]
)
def test_all_triangles_degenerate(tmp_path, name, content):
    assert "all of its 2 triangles have no area" in refused(written(tmp_path, name, content))


MILLIONS = 50_000_000


@pytest.mark.parametrize(
    "content",
    [
        ply(["0 1 2"], n_faces=MILLIONS),
        ply(["0 1 2"], n_faces=MILLIONS, vertices=MILLIONS),
        ply(["0 1 2"], vertices=MILLIONS),
        binary_ply(["0 1 2"], n_faces=MILLIONS),
        binary_ply(["0 1 2"], n_faces=MILLIONS, vertices=MILLIONS),
        binary_ply(["0 1 2"], vertices=MILLIONS, order="big"),
    ],
    ids=["ascii faces", "ascii both", "ascii vertices", "binary faces", "binary both", "binary vertices"],
)
def test_a_header_that_promises_50_million_triangles(tmp_path, content):
    """A file of 300 bytes: nothing of that size is allocated before it is refused."""
    path = written(tmp_path, "huge.ply", content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 1024  # KiB on Linux


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("big.ply", ply(["0 1 2", "0 1 5"])),
        ("big.ply", binary_ply(["0 1 2", "0 1 5"])),
        ("big.ply", binary_ply(["0 1 2000000000"])),
        ("big.obj", OBJ + "f 1 2 3\nf 1 2 6\n"),
        ("negative.ply", ply(["0 1 2", "0 3 -1"])),
        ("negative.ply", binary_ply(["0 1 2", "0 3 -1"])),
        ("negative.obj", OBJ + "f 1 2 -6\n"),
    ],
)
def test_indices_out_of_range(tmp_path, capfd, name, content):
    message = refused(written(tmp_path, name, content))
    assert re.search("ind(ex|ices)|corner|vertex|vertices", message)
    assert capfd.readouterr().err == ""


def test_the_index_zero_of_an_obj_file_is_no_vertex(tmp_path):
    """They count from 1; 0 must not mean the last one."""
    refused(written(tmp_path, "zero.obj", OBJ + "f 1 2 3\nf 0 2 3\n"))


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e39"])
@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_vertices_that_are_no_numbers(tmp_path, suffix, value):
    corners = [f"{value} 0 0", *CORNERS[1:], "0.3 0.7 0"]
    double = ply(["0 1 2", "1 3 2"], corners).replace(b"float", b"double")
    content = double if suffix == "ply" else "".join(f"v {c}\n" for c in corners) + "f 1 2 3\nf 2 4 3\n"
    assert re.search("NaN|infinite|finite|float32", refused(written(tmp_path, f"v.{suffix}", content)))


def test_a_mesh_smaller_than_numbers_are(tmp_path):
    corners = "v 0 0 0\nv 1e-310 0 0\nv 0 1e-310 0\n"
    assert "within 1e-37 of one point" in refused(written(tmp_path, "tiny.obj", corners + "f 1 2 3\n"))


@pytest.mark.parametrize(
    "content",
    ["v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "v 0\nv 1\nv 2\nf 1 2 3\n", "v 0 0 zero\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"],
    ids=["two coordinates", "one coordinate", "a word"],
)
def test_damaged_obj_files(tmp_path, content):
    refused(written(tmp_path, "damaged.obj", content))


@pytest.mark.parametrize("keep", [0.2, 0.6, 0.95])
@pytest.mark.parametrize("make", [ply, binary_ply])
def test_truncated_ply_files(tmp_path, make, keep):
    content = make(["0 1 2"] * 20)
    refused(written(tmp_path, "cut.ply", content[: int(keep * len(content))]))


def test_missing_files_folders_and_suffixes(tmp_path):
    assert "no such file" in refused(tmp_path / "absent.ply", FileNotFoundError)
    (tmp_path / "folder.ply").mkdir()
    assert refused(tmp_path / "folder.ply", (ValueError, OSError))
    for name in ("mesh.stl", "mesh", "mesh.ply.gz"):
        assert ".ply, .obj, .glb or .gltf" in refused(written(tmp_path, name, ply(["0 1 2"])))


def test_damaged_files_by_the_hundred(tmp_path):
    """Whatever bytes change: a sound mesh or one line with the file's name, nothing else."""
    sphere = trimesh.creation.icosphere(subdivisions=1)
    sphere = trimesh.Trimesh(sphere.vertices, sphere.faces, vertex_normals=sphere.vertices, process=False)
    seeds = {
        "b.ply": trimesh.exchange.ply.export_ply(sphere, vertex_normal=True),
        "a.ply": trimesh.exchange.ply.export_ply(sphere, encoding="ascii", vertex_normal=True),
        "o.obj": trimesh.exchange.obj.export_obj(sphere, include_normals=True).encode(),
        "g.glb": trimesh.exchange.gltf.export_glb(trimesh.Scene([sphere]), include_normals=True),
    }
    rng = np.random.default_rng(4)
    wrong = {}
    for trial in range(480):
        name = list(seeds)[trial % 4]
        content = bytearray(seeds[name])
        for _ in range(rng.integers(1, 5)):
            at = rng.integers(0, len(content) if rng.random() < 0.5 else 400)
            if trial // 4 % 2:
                content[at] = ord(rng.choice(list("0123456789-.e \n")))
            else:
                content[at : at + 1] = rng.bytes(rng.integers(0, 3))
        path = written(tmp_path, name, bytes(content))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                mesh = TriangleMesh.open(path)
            except ValueError as error:
                if not str(error).startswith(f"{path}: ") or "\n" in str(error):
                    wrong[trial] = repr(error)
                continue
            except Exception as error:
                wrong[trial] = repr(error)
                continue
        foreign = [str(w.message) for w in caught if not str(w.message).startswith(f"{path}: ")]
        used = np.unique(mesh.faces)
        if foreign or used[0] < 0 or used[-1] >= len(mesh.vertices) or not np.isfinite(mesh.vertices[used]).all():
            wrong[trial] = f"{foreign} {used[[0, -1]]}"
        elif not np.isfinite(mesh.normals[used]).all():
            wrong[trial] = "normals"
    assert not wrong


def test_no_traceback_or_log_reaches_the_user(tmp_path):
    """In a fresh process, where trimesh's logger has no handler."""
    path = written(tmp_path, "negative.ply", ply(["0 1 2", "0 3 -1"]))
    script = (
        "from torchbrdf.view.mesh import TriangleMesh\n"
        f"try: TriangleMesh.open({str(path)!r})\nexcept ValueError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.stderr == ""
    assert done.stdout.startswith(f"{path}: ")


@pytest.mark.parametrize("scale", [1e-35, 1e-9, 1e20])
def test_smooth_normals_do_not_depend_on_the_unit_of_length(tmp_path, scale):
    """Two triangles that meet at an angle: the two vertices that they share have the normals' mean."""

    def shown(factor: float) -> np.ndarray:
        points = (0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.3)
        corners = [f"{factor * x} {factor * y} {factor * z}" for x, y, z in points]
        mesh, _ = opened(written(tmp_path, "sheet.ply", ply(["0 1 2", "1 3 2"], corners)))
        return mesh.normals[mesh.faces]

    np.testing.assert_allclose(shown(scale), shown(1), atol=1e-6)
    assert len(np.unique(shown(scale).round(5).reshape(-1, 3), axis=0)) > 1


def test_tiny_triangles_beside_large_ones_have_unit_normals(tmp_path):
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 2", "1e-38 0 2", "0 1e-38 2"]
    mesh, _ = opened(written(tmp_path, "two.ply", ply(["0 1 2", "3 4 5"], corners)))
    np.testing.assert_allclose(mesh.normals[mesh.faces], np.broadcast_to([0, 0, 1], (2, 3, 3)), atol=1e-6)


def test_one_face_without_a_mean_normal_leaves_the_others_smooth(tmp_path):
    corners = ["0 0 0", "1 0 0", "0 1 0", "1 1 0.3", "5 0 0", "6 0 0", "5 1 0"]
    mesh, _ = opened(written(tmp_path, "sheet.ply", ply(["0 1 2", "1 3 2", "4 5 6", "4 6 5"], corners)))
    normals = mesh.normals[mesh.faces]
    np.testing.assert_allclose((normals**2).sum(-1), 1, atol=1e-5)
    smooth = mesh.vertices[mesh.faces].max((1, 2)) < 2
    assert smooth.sum() == 2
    assert len(np.unique(normals[smooth].round(5).reshape(-1, 3), axis=0)) == 3


def test_messages_escape_what_does_not_print(tmp_path):
    path = written(tmp_path, "a.gltf", '{"asset": {"version": "\x7fE"}}')
    with pytest.raises(ValueError, match=r"a\.gltf: .* it is glTF \\x7fE; export it as glTF 2\.0$"):
        TriangleMesh.open(path)
