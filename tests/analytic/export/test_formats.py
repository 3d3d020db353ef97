"""Files of analytic BRDFs, read back by the libraries of the programs that they are for."""

import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from math import pi
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from bsdf_cases import bsdf_f_r, direction_pairs
from fits import BRASS, NAME, fitted
from paths import ROOT
from torchbrdf.analytic.export.formats import FORMATS, format_of, native_fit, write_binary
from torchbrdf.analytic.export.gltf import write_gltf
from torchbrdf.analytic.export.materialx import SURFACES, write_materialx
from torchbrdf.analytic.export.mitsuba import mitsuba_bsdf, write_mitsuba
from torchbrdf.brdf.merl import MerlTable

GGX = fitted("ggx", diffuse=[0.3, 0.2, 0.1], specular=[0.04, 0.05, 0.06], roughness=0.2)
SEPARATE = fitted("metallic-roughness", base_color=[0.9, 0.6, 0.2], metallic=0.75, roughness=[0.3, 0.4, 0.5])

OF_MITSUBA = {
    "principled": fitted(
        "principled",
        base_color=[0.7, 0.4, 0.1],
        roughness=0.45,
        metallic=0.3,
        specular=0.6,
        spec_tint=0.2,
        sheen=0.4,
        sheen_tint=0.7,
        flatness=0.35,
        clearcoat=0.8,
        clearcoat_gloss=0.6,
    ),
    "rough-conductor": fitted("rough-conductor", eta=[0.2, 0.9, 1.4], k=[3.9, 2.4, 12.5], roughness=0.25),
    "rough-plastic": fitted(
        "rough-plastic", diffuse=[0.6, 0.3, 0.1], specular=[0.9, 0.8, 0.7], eta=1.6, roughness=0.15
    ),
}


def assert_same_brdf(got: torch.Tensor, expected: torch.Tensor) -> None:
    """To 1e-4, where f_r is above a thousandth of what it is elsewhere: Mitsuba computes in float32."""
    torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-4 * float(expected.median()))


@pytest.mark.parametrize("model", OF_MITSUBA)
def test_dictionary_evaluates_as_our_model(mitsuba: ModuleType, model):
    fit = OF_MITSUBA[model]
    w_i, w_o = direction_pairs(500)
    assert_same_brdf(bsdf_f_r(mitsuba, mitsuba_bsdf(fit), w_i, w_o), fit.f_r(w_i, w_o))


@pytest.mark.parametrize("model", OF_MITSUBA)
def test_scene_holds_that_bsdf_and_renders(mitsuba: ModuleType, tmp_path, model):
    fit = OF_MITSUBA[model]
    write_mitsuba(fit, tmp_path / "a scene é.xml")
    scene = mitsuba.load_file(str(tmp_path / "a scene é.xml"), spp="4", size="24")
    (sphere,) = (shape for shape in scene.shapes() if not shape.is_emitter())
    w_i, w_o = direction_pairs(500, seed=1)
    loaded = {"type": "twosided", "as_it_is": sphere.bsdf()}
    assert_same_brdf(bsdf_f_r(mitsuba, loaded, w_i, w_o), fit.f_r(w_i, w_o))
    image = np.array(mitsuba.render(scene))
    assert image.shape == (24, 24, 3)
    assert np.isfinite(image).all()
    assert image[12, 12].min() > 0
    assert image[12, 12].std() > 0, "a coloured material under white light"


def test_scene_by_hand(tmp_path):
    """What an XML of Mitsuba looks like, and that the numbers are there for people, too."""
    write_mitsuba(OF_MITSUBA["rough-conductor"], tmp_path / "x.xml")
    bsdf = ET.parse(tmp_path / "x.xml").getroot().find("bsdf")
    assert bsdf is not None
    assert bsdf.attrib == {"type": "roughconductor", "id": "brass_rough_2"}
    assert [(child.tag, child.get("name"), child.get("value")) for child in bsdf] == [
        ("string", "distribution", "ggx"),
        ("rgb", "eta", "0.2, 0.9, 1.4"),
        ("rgb", "k", "3.9, 2.4, 12.5"),
        ("float", "alpha", "0.25"),
    ]
    assert "relative error 12.50% (l2)" in (tmp_path / "x.xml").read_text()


def test_index_of_plastic_is_that_to_vacuum():
    """Mitsuba's default outside is air of 1.000277, and its default diffuse reflection is linear."""
    described = mitsuba_bsdf(OF_MITSUBA["rough-plastic"])
    assert described["ext_ior"] == 1.0
    assert described["int_ior"] == 1.6
    assert described["nonlinear"] is False


def test_dictionary_in_a_file(mitsuba: ModuleType, tmp_path):
    for model, fit in OF_MITSUBA.items():
        write_mitsuba(fit, tmp_path / "x.json")
        read = json.loads((tmp_path / "x.json").read_text())
        assert read == mitsuba_bsdf(fit), model
        mitsuba.load_dict(read)


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
def test_gltf_by_pygltflib(tmp_path, suffix):
    pygltflib = pytest.importorskip("pygltflib")
    write_gltf(BRASS, tmp_path / f"x{suffix}")
    read = pygltflib.GLTF2().load(str(tmp_path / f"x{suffix}"))
    assert read.asset.version == "2.0"
    (material,) = read.materials
    assert material.name == NAME
    surface = material.pbrMetallicRoughness
    assert surface.baseColorFactor == [0.9, 0.6, 0.2, 1.0], "linear, as glTF has it"
    assert (surface.metallicFactor, surface.roughnessFactor) == (0.75, 0.3)
    assert "relative error 12.50%" in material.extras["torchbrdf"]
    assert (read.textures, read.images, surface.baseColorTexture) == ([], [], None)

    (primitive,) = read.meshes[0].primitives
    assert primitive.material == 0
    assert primitive.attributes.TEXCOORD_0 is None
    binary = read.binary_blob() if suffix == ".glb" else read.get_data_from_buffer_uri(read.buffers[0].uri)
    assert len(binary) == read.buffers[0].byteLength

    def values(index: int, kind: str, width: int) -> np.ndarray:
        accessor = read.accessors[index]
        view = read.bufferViews[accessor.bufferView]
        assert view.byteOffset % 4 == 0
        part = np.frombuffer(binary, kind, accessor.count * width, offset=view.byteOffset)
        assert part.nbytes == view.byteLength
        return part.reshape(accessor.count, width)

    positions = values(primitive.attributes.POSITION, "<f4", 3)
    normals = values(primitive.attributes.NORMAL, "<f4", 3)
    faces = values(primitive.indices, "<u2", 1).reshape(-1, 3)
    limits = read.accessors[primitive.attributes.POSITION]
    assert (limits.min, limits.max) == (positions.min(0).tolist(), positions.max(0).tolist())
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    np.testing.assert_array_equal(normals, positions)
    assert sorted(set(faces.ravel().tolist())) == list(range(len(positions)))
    corners = positions[faces].astype(float)
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.sum(outward * corners.mean(1), axis=1) > 0).all(), "faces are counter-clockwise from outside"


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
def test_gltf_by_trimesh(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    write_gltf(BRASS, tmp_path / f"x{suffix}")
    (mesh,) = trimesh.load(tmp_path / f"x{suffix}").geometry.values()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * pi, rel=0.01)
    material = mesh.visual.material
    assert (material.metallicFactor, material.roughnessFactor) == (0.75, 0.3)
    np.testing.assert_allclose(material.baseColorFactor, [230, 153, 51, 255], atol=1)


@pytest.mark.parametrize("surface", SURFACES)
def test_materialx_by_its_own_library(tmp_path, surface):
    mx = pytest.importorskip("MaterialX")
    write_materialx(BRASS, tmp_path / "x.mtlx", surface)
    document, standard = mx.createDocument(), mx.createDocument()
    mx.readFromXmlFile(document, str(tmp_path / "x.mtlx"))
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), standard)
    document.importLibrary(standard)
    assert document.validate() == (True, "")
    assert document.getColorSpace() == "lin_rec709"
    (material,) = document.getMaterialNodes()
    assert material.getName() == "brass_rough_2"
    assert "relative error 12.50%" in material.getDocString()
    (shader,) = mx.getShaderNodes(material)
    assert shader.getCategory() == surface
    definition = shader.getNodeDef()
    assert definition is not None
    for given in shader.getInputs():
        assert definition.getActiveInput(given.getName()).getType() == given.getType()
    index = "specular_IOR" if surface == "standard_surface" else "specular_ior"
    metalness = "metalness" if surface == "standard_surface" else "base_metalness"
    expected = {index: 1.5, metalness: 0.75, "specular_roughness": 0.3}
    for name, value in expected.items():
        assert shader.getInputValue(name) == pytest.approx(value)
    assert list(shader.getInputValue("base_color").asTuple()) == pytest.approx([0.9, 0.6, 0.2])


def test_materialx_takes_roughness_and_metalness_as_gltf_does():
    """Its own translation of standard_surface to glTF: alpha is the square of the roughness in both."""
    mx = pytest.importorskip("MaterialX")
    standard = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), standard)
    graph = standard.getNodeGraph("NG_standard_surface_to_gltf_pbr")
    root = graph.getNode("roughness")
    assert root.getCategory() == "sqrt"
    alpha = root.getConnectedNode("in").getConnectedNode("in")
    assert alpha.getCategory() == "roughness_anisotropy", "which is the square, where isotropic"
    assert alpha.getInput("roughness").getInterfaceName() == "specular_roughness"
    metallic = graph.getNode("metallic")
    assert (metallic.getCategory(), metallic.getInput("in").getInterfaceName()) == ("dot", "metalness")


def test_table(tmp_path):
    write_binary(GGX, tmp_path / "x.binary")
    torch.testing.assert_close(MerlTable.open(tmp_path / "x.binary").filled, GGX.table.filled, rtol=1e-12, atol=1e-15)


def test_other_programs_are_not_needed(tmp_path):
    """Files are written where neither Mitsuba nor any reader of the formats is installed."""
    script = f"""
import sys
for name in ("mitsuba", "drjit", "MaterialX", "pygltflib"):
    sys.modules[name] = None
sys.path[:0] = {[str(ROOT / "tests"), str(Path(__file__).parent)]!r}
from test_formats import *
write_mitsuba(OF_MITSUBA["principled"], "x.xml")
write_gltf(BRASS, "x.glb")
write_materialx(BRASS, "x.mtlx")
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.glb", "x.mtlx", "x.xml"]


@pytest.mark.parametrize(
    ("name", "identifier"),
    [("gold-paint", "gold_paint"), ("100 %", "material_100"), ("", "material"), ("-- é --", "material")],
)
def test_names_that_are_no_identifiers(tmp_path, name, identifier):
    fit = fitted("metallic-roughness", name, base_color=[0.9, 0.6, 0.2], metallic=0.75, roughness=0.3)
    write_materialx(fit, tmp_path / "x.mtlx")
    assert ET.parse(tmp_path / "x.mtlx").getroot().find("surfacematerial").get("name") == identifier
    write_gltf(fit, tmp_path / "x.gltf")
    assert json.loads((tmp_path / "x.gltf").read_text())["materials"][0]["name"] == name


def test_numbers_that_are_as_good_as_zero():
    fit = fitted("rough-conductor", eta=[0.2, 0.9, 1.4], k=[7e-24, 2.4, 12.123456789], roughness=0.25)
    assert mitsuba_bsdf(fit)["k"]["value"] == [0.0, 2.4, 12.12346]


def test_what_a_format_cannot_hold(tmp_path):
    cases = [
        (write_mitsuba, "x.xml", GGX, "Mitsuba has no model ggx; fit principled or rough-conductor or rough-plastic"),
        (write_mitsuba, "x.json", BRASS, "Mitsuba has no model metallic-roughness; fit principled or"),
        (write_gltf, "x.glb", GGX, "glTF has no model ggx; fit metallic-roughness to the same table, as native_fit"),
        (write_gltf, "x.glb", SEPARATE, "glTF has one number for all channels of what is no colour; fit with shared"),
        (write_materialx, "x.mtlx", GGX, "MaterialX has no model ggx; fit metallic-roughness to the same table"),
        (write_materialx, "x.mtlx", SEPARATE, "MaterialX has one number for all channels of what is no colour"),
        (write_mitsuba, "x.bsdf", OF_MITSUBA["principled"], "x.bsdf: a mitsuba file ends in .xml or .json, not in '.b"),
        (write_gltf, "x.obj", BRASS, "x.obj: a gltf file ends in .glb or .gltf, not in '.obj'"),
        (write_materialx, "x.xml", BRASS, "x.xml: a materialx file ends in .mtlx, not in '.xml'"),
        (write_binary, "x.bin", GGX, "x.bin: a binary file ends in .binary, not in '.bin'"),
    ]
    for write, file, fit, message in cases:
        with pytest.raises(ValueError, match=r"^[^\n]+$") as caught:
            write(fit, tmp_path / file)
        assert str(caught.value).removeprefix(f"{tmp_path}/").startswith(message)
    with pytest.raises(ValueError, match=r"^surface must be one of standard_surface, open_pbr_surface, got 'disney'$"):
        write_materialx(BRASS, tmp_path / "x.mtlx", "disney")
    assert list(tmp_path.iterdir()) == []


def test_formats_by_suffix_and_name(tmp_path):
    assert format_of(tmp_path / "x.GLTF").name == "gltf"
    assert format_of(tmp_path / "x.mtlx").name == "materialx"
    assert format_of(tmp_path / "x.mtlx", "openpbr").name == "openpbr"
    with pytest.raises(ValueError, match=r"x\.usd: no format has the suffix '\.usd'; use one of \.xml \(mitsuba\), "):
        format_of(tmp_path / "x.usd")
    with pytest.raises(ValueError, match=r"^format must be one of mitsuba, gltf, materialx, openpbr, binary, got 'ma'"):
        format_of(tmp_path / "x.ma", "ma")
    for name, one in FORMATS.items():
        assert format_of(tmp_path / f"x{one.suffixes[0]}", name) is one


def test_whole_or_absent(tmp_path, monkeypatch):
    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("pathlib.Path.write_bytes", fail)
    cases = ((write_mitsuba, "x.xml", OF_MITSUBA["principled"]), (write_gltf, "x.glb", BRASS))
    for write, file, fit in (*cases, (write_materialx, "x.mtlx", BRASS)):
        with pytest.raises(OSError, match="disk full"):
            write(fit, tmp_path / file)
    assert list(tmp_path.iterdir()) == []


def test_native_fit_keeps_what_is_native():
    plastic = OF_MITSUBA["rough-plastic"]
    assert native_fit(plastic, plastic.table, FORMATS["mitsuba"]) is plastic
    assert native_fit(GGX, GGX.table, FORMATS["binary"]) is GGX
    assert native_fit(SEPARATE, GGX.table, FORMATS["binary"]) is SEPARATE


def test_native_fit_takes_a_format_and_no_name_of_one():
    message = "native_fit: wanted must be a Format, got 'mitsuba'; take one of torchbrdf.analytic.export.FORMATS, "
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        native_fit(GGX, GGX.table, "mitsuba")


def test_native_fit_does_not_carry_a_photograph_over():
    refined = replace(GGX, metric="pixels")
    message = "ggx was fitted to a photograph, and a gltf file holds metallic-roughness; fit that to the photograph: "
    with pytest.raises(ValueError, match=f"^{message}"):
        native_fit(refined, GGX.table, FORMATS["gltf"])
    assert native_fit(refined, GGX.table, FORMATS["binary"]) is refined


@pytest.mark.parametrize("other", [GGX, SEPARATE])
def test_native_fit_carries_others_over(other):
    """To the table, not to the other model: planted parameters are found."""
    held = native_fit(other, BRASS.table, FORMATS["gltf"])
    assert held.model == "metallic-roughness"
    assert held.metric == other.metric
    assert held.error < 1e-3
    for name, value in BRASS.parameters.items():
        torch.testing.assert_close(held.parameters[name], value, rtol=1e-3, atol=1e-3)
