"""glTF 2.0: buffers inside, beside and as data URIs; nodes; what is refused by name."""

import base64
import json
import struct

import numpy as np
import pytest

from torchbrdf.view._gltf import read_gltf

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], "<f4")
NORMALS = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [0, 0, 1]], "<f4")
INDICES = np.array([0, 1, 2, 2, 1, 3], "<u2")
BINARY = POINTS.tobytes() + NORMALS.tobytes() + INDICES.tobytes()


def document(**changes):
    """A scene with one node and one mesh of two triangles; changes replace entries of its top level."""
    views = [{"buffer": 0, "byteOffset": at, "byteLength": size} for at, size in ((0, 48), (48, 48), (96, 12))]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
    ]
    mesh = {"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}]}
    whole = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [mesh],
        "buffers": [{"byteLength": len(BINARY)}], "bufferViews": views, "accessors": accessors,
    }  # fmt: skip
    return whole | changes


def glb(scene, binary=BINARY):
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def triangles(content, folder):
    return np.concatenate([part.vertices[part.corners].reshape(-1, 3, 3) for part in read_gltf(content, folder)])


PLAIN = POINTS[INDICES].reshape(2, 3, 3)


def test_a_glb_file(tmp_path):
    (part,) = read_gltf(glb(document()), tmp_path)
    np.testing.assert_array_equal(part.vertices[part.corners], POINTS[INDICES])
    np.testing.assert_array_equal(part.normals[part.corners], NORMALS[INDICES])


@pytest.mark.parametrize("uri", ["shape one.bin", "shape%20one.bin"])
def test_numbers_beside_the_file(tmp_path, uri):
    (tmp_path / "shape one.bin").write_bytes(BINARY)
    scene = document(buffers=[{"byteLength": len(BINARY), "uri": uri}])
    np.testing.assert_array_equal(triangles(json.dumps(scene).encode(), tmp_path), PLAIN)


def test_numbers_in_the_text(tmp_path):
    uri = "data:application/octet-stream;base64," + base64.b64encode(BINARY).decode()
    scene = document(buffers=[{"byteLength": len(BINARY), "uri": uri}])
    np.testing.assert_array_equal(triangles(json.dumps(scene).encode(), tmp_path), PLAIN)


@pytest.mark.parametrize("scene", [{"scene": 0}, {"scenes": []}, {"scenes": [], "nodes": []}])
def test_files_without_a_scene_show_everything(tmp_path, scene):
    np.testing.assert_array_equal(triangles(glb(document(**scene)), tmp_path), PLAIN)


def test_nodes_place_their_meshes(tmp_path):
    """Scaled, then turned by 90 degrees about Z, then moved; and all that by the matrix of the node above."""
    half = 0.5**0.5
    lower = {"mesh": 0, "scale": [2, 3, 4], "rotation": [0, 0, half, half], "translation": [10, 0, 0]}
    upper = {"children": [1], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 5, 1]}
    (part,) = read_gltf(glb(document(nodes=[upper, lower])), tmp_path)
    moved = POINTS * [2, 3, 4] @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] * [1, 1, -1] + [10, 0, 5]
    np.testing.assert_allclose(part.vertices, moved, atol=1e-6)
    normals = NORMALS / [2, 3, 4] @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] * [1, 1, -1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(part.normals, normals, atol=1e-6)
    a, b, c = part.vertices[part.corners].reshape(2, 3, 3).swapaxes(0, 1)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), part.normals[part.corners[::3]]) > 0).all()


def test_a_mesh_at_two_nodes(tmp_path):
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [0, 0, 9]}]
    found = triangles(glb(document(nodes=nodes, scenes=[{"nodes": [0, 1]}])), tmp_path)
    assert sorted(found[:, 0, 2].tolist()) == [0, 0, 9, 9]


@pytest.mark.parametrize(
    ("mode", "expected"),
    [(None, [[0, 1, 2], [2, 1, 3]]), (5, [[0, 1, 2], [2, 1, 2], [2, 2, 1], [1, 2, 3]]),
     (6, [[0, 1, 2], [0, 2, 2], [0, 2, 1], [0, 1, 3]])],
)  # fmt: skip
def test_strips_and_fans(tmp_path, mode, expected):
    primitive = {"attributes": {"POSITION": 0}, "indices": 2} | ({} if mode is None else {"mode": mode})
    (part,) = read_gltf(glb(document(meshes=[{"primitives": [primitive]}])), tmp_path)
    assert part.corners.reshape(-1, 3).tolist() == expected


def test_points_and_lines_are_passed_over(tmp_path):
    primitives = [{"attributes": {"POSITION": 0}, "mode": mode} for mode in range(4)]
    assert read_gltf(glb(document(meshes=[{"primitives": primitives}])), tmp_path) == []


def test_without_indices_corners_follow_each_other(tmp_path):
    scene = document(meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}])
    scene["accessors"][0]["count"] = 3
    np.testing.assert_array_equal(triangles(glb(scene), tmp_path), PLAIN[:1])


def test_interleaved_and_quantised_numbers(tmp_path):
    rows = np.zeros(4, [("point", "<i2", 3), ("fill", "<i2"), ("normal", "i1", 3), ("rest", "i1")])
    rows["point"], rows["normal"] = POINTS * 100, np.round(NORMALS * 127)
    scene = document(
        extensionsRequired=["KHR_mesh_quantization"],
        bufferViews=[
            {"buffer": 0, "byteLength": 48, "byteStride": 12},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        accessors=[
            {"bufferView": 0, "componentType": 5122, "count": 4, "type": "VEC3"},
            {"bufferView": 0, "componentType": 5120, "count": 4, "type": "VEC3", "byteOffset": 8, "normalized": True},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
    )
    (part,) = read_gltf(glb(scene, rows.tobytes() + INDICES.tobytes()), tmp_path)
    np.testing.assert_array_equal(part.vertices, POINTS * 100)
    np.testing.assert_allclose(part.normals, NORMALS, atol=0.005)


def with_primitive(**entries):
    return document(meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 2} | entries]}])


def compressed():
    scene = with_primitive(extensions={"KHR_draco_mesh_compression": {"bufferView": 0}})
    del scene["accessors"][0]["bufferView"]
    return scene


def sparse():
    scene = document()
    scene["accessors"][0]["sparse"] = {}
    return scene


REFUSED = {
    "draco": (compressed(), "extension KHR_draco_mesh_compression, which is not read"),
    "meshopt": (document(extensionsRequired=["EXT_meshopt_compression"]), "extension EXT_meshopt_compression"),
    "unknown": (document(extensionsRequired=["ACME_shape"]), "extension ACME_shape"),
    "instances": (document(nodes=[{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]), "EXT_mesh_gpu_inst"),
    "sparse": (sparse(), "accessor 0 is sparse or empty"),
    "skin": (document(nodes=[{"mesh": 0, "skin": 0}]), "posed by a skeleton"),
    "morph": (document(nodes=[{"mesh": 0, "weights": [0, 0.5]}]), "morph targets"),
    "version": (document(asset={"version": "1.0"}), "glTF 1.0; export it as glTF 2.0"),
    "no asset": (document(asset={}), "does not follow glTF 2.0"),
    "circle": (document(nodes=[{"children": [1]}, {"children": [0]}]), "node 0 hangs at two places"),
    "no mesh": (document(nodes=[{"mesh": 3}]), "names entry 3 of its 1 meshes"),
    "negative": (document(nodes=[{"mesh": -1}]), "names entry -1 of its 1 meshes"),
    "kind": (with_primitive(indices=0), "holds VEC3 in place of SCALAR"),
    "short view": (document(bufferViews=[{"buffer": 0, "byteLength": 40}] * 3), "accessor 0 is longer than its data"),
    "short buffer": (document(bufferViews=[{"buffer": 0, "byteOffset": 90, "byteLength": 99}] * 3), "longer than its"),
    "endless name": (document(buffers=[{"byteLength": 9, "uri": "A" * 5000}]), "which is not there"),
    "absent": (document(buffers=[{"byteLength": 9, "uri": "no.bin"}]), "numbers lie in 'no.bin', which is not there"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_read_is_named(tmp_path, case):
    scene, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        [part.compact() for part in read_gltf(glb(scene), tmp_path)]


@pytest.mark.parametrize("lost", [1, 20, 200, 700])
def test_truncated_files(tmp_path, lost):
    content = glb(document())
    with pytest.raises(ValueError, match="truncated"):
        read_gltf(content[:-lost], tmp_path)
