"""Measured materials of the RGL database: the container, the evaluation against Mitsuba, tables, files written."""

import struct
from collections.abc import Iterator
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from bsdf_cases import bsdf_f_r, direction_pairs
from torchbrdf.brdf._tensor_file import TensorFile, write_tensor_file
from torchbrdf.brdf.difference import cell_difference
from torchbrdf.brdf.directions import from_half_difference
from torchbrdf.brdf.merl import MerlTable, above_horizon, cell_centres
from torchbrdf.brdf.rgl import WHAT, RGLMaterial
from torchbrdf.brdf.rgl_table import tabulate
from torchbrdf.brdf.spectra import SPECTRAL_NODES, basis_spectra, to_rec709
from torchbrdf.brdf.tables import read_table
from torchbrdf.mitsuba_startup import load_mitsuba

NODES = 12


@pytest.fixture(scope="module", autouse=True)
def few_cells() -> Iterator[Tensor]:
    """Materials are put on every third theta_d and every fourth phi_d of MERL's grid, in all rows of theta_h."""
    few = torch.zeros_like(above_horizon())
    few[:, 1::3, 2::4] = above_horizon()[:, 1::3, 2::4]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchbrdf.brdf.rgl_table.above_horizon", lambda: few)
        yield few


def fields(azimuths: int = 1, seed: int = 0) -> dict[str, np.ndarray]:
    """A rough material, of random colours, in the layout of the database."""
    random = np.random.default_rng(seed)
    theta_i = np.array([0, 0.4, 0.8, 1.2, pi / 2], np.float32)
    shape = (azimuths, len(theta_i))
    colours = random.uniform(0.2, 1, (*shape, 3, NODES, NODES)).astype(np.float32)
    u = np.linspace(0, 1, 24, dtype=np.float32)
    return {
        "description": np.frombuffer(b"made up", np.uint8),
        "phi_i": np.linspace(-pi, pi, azimuths, dtype=np.float32) if azimuths > 1 else np.zeros(1, np.float32),
        "theta_i": theta_i,
        "sigma": np.tile(1 - 0.8 * u**2, (2, 1)),
        "ndf": np.tile(np.exp(-3 * u**2), (2, 1)),
        "vndf": random.uniform(0.5, 2, (*shape, 16, 24)).astype(np.float32),
        "luminance": np.ones((*shape, NODES, NODES), np.float32),
        "rgb": colours,
        "jacobian": np.ones(1, np.uint8),
    }


@pytest.fixture
def written(tmp_path: Path):
    """Write such fields, some of them others or without."""

    def write(without: tuple[str, ...] = (), azimuths: int = 1, **others: np.ndarray) -> Path:
        held = {**fields(azimuths), **others}
        path = tmp_path / "made.bsdf"
        write_tensor_file(path, {name: value for name, value in held.items() if name not in without})
        return path

    return write


@pytest.fixture(scope="module")
def glossy() -> MerlTable:
    """A coloured lobe on a coloured ground."""
    colour, ground = torch.tensor([0.9, 0.5, 0.2]), torch.tensor([0.1, 0.2, 0.3])

    def f_r(w_i: Tensor, w_o: Tensor) -> Tensor:
        z = torch.nn.functional.normalize(w_i + w_o, dim=-1)[..., 2:]
        return colour * z**60 + ground / pi

    return MerlTable.from_function(f_r, "glossy")


def evaluated(material: RGLMaterial, w_i: Tensor, w_o: Tensor) -> Tensor:
    m = torch.nn.functional.normalize(w_i + w_o, dim=1)
    theta_i, theta_m = (torch.atan2(torch.hypot(d[:, 0], d[:, 1]), d[:, 2]) for d in (w_i, m))
    azimuth = torch.atan2(m[:, 1], m[:, 0]) - torch.atan2(w_i[:, 1], w_i[:, 0])
    return material.cos_weighted(*(a.float() for a in (theta_i, theta_m, azimuth)))[0] / w_o[:, 2:]


class TestEvaluation:
    def test_is_mitsubas(self, written):
        path = written()
        w_i, w_o = direction_pairs(4000, seed=1, lowest=0.05)
        reference = bsdf_f_r(load_mitsuba(), {"type": "measured", "filename": str(path)}, w_i, w_o)
        found = evaluated(RGLMaterial.open(path), w_i, w_o).double()
        assert float((found - reference).norm() / reference.norm()) < 2e-5

    def test_without_the_density_of_normals(self, written):
        path = written(jacobian=np.zeros(1, np.uint8))
        w_i, w_o = direction_pairs(500, seed=2, lowest=0.05)
        reference = bsdf_f_r(load_mitsuba(), {"type": "measured", "filename": str(path)}, w_i, w_o)
        found = evaluated(RGLMaterial.open(path), w_i, w_o).double()
        assert float((found - reference).norm() / reference.norm()) < 2e-5


class TestSpectra:
    def test_white_is_white(self):
        np.testing.assert_allclose(to_rec709(np.array([450.0, 600.0])).sum(1), 1, rtol=1e-12)

    def test_are_as_mitsuba_has_them(self):
        mitsuba = load_mitsuba()
        wavelengths = np.linspace(360, 830, 95)
        spectrum = np.exp(-(((wavelengths - 560) / 60) ** 2))
        reference = np.array(mitsuba.spectrum_list_to_srgb(wavelengths.tolist(), spectrum.tolist(), False, True))
        found = (to_rec709(wavelengths) @ spectrum).clip(0)  # as Mitsuba clips
        np.testing.assert_allclose(found, reference, rtol=2e-3)

    def test_basis_gives_the_colours_back(self):
        np.testing.assert_allclose(to_rec709(SPECTRAL_NODES) @ basis_spectra(), np.eye(3), atol=1e-4)

    def test_basis_sums_to_one_and_reflects_no_more(self):
        basis = basis_spectra()
        np.testing.assert_allclose(basis.sum(1), 1, atol=1e-4)
        assert basis.min() >= 0

    def test_spectral_files_have_the_colours_of_rgb_ones(self, written):
        colours = fields()["rgb"]
        rgb = MerlTable.from_bsdf(written())
        spectra = np.einsum("wc,ptcyx->ptwyx", basis_spectra(), colours).astype(np.float32)
        wavelengths = SPECTRAL_NODES.astype(np.float32)
        spectral = MerlTable.from_bsdf(written(("rgb",), spectra=spectra, wavelengths=wavelengths))
        torch.testing.assert_close(spectral.values, rgb.values, rtol=1e-3, atol=1e-3)


class TestTables:
    def test_a_white_lambertian(self, tmp_path: Path, glossy: MerlTable):
        white = MerlTable.from_function(lambda w_i, _: torch.full((*w_i.shape[:-1], 3), 1 / pi), "white")
        white.save(tmp_path / "white.bsdf")
        found = read_table(tmp_path / "white.bsdf")
        assert cell_difference(found, white, "l2") < 2e-3

    @pytest.mark.parametrize("spectral", [False, True])
    def test_there_and_back(self, tmp_path: Path, glossy: MerlTable, few_cells: Tensor, spectral: bool):
        glossy.save(tmp_path / "x.bsdf", spectral)
        back = read_table(tmp_path / "x.bsdf")
        assert cell_difference(back, glossy, "l2") < 0.01
        assert float((back.valid & few_cells).sum()) > 0.95 * float(few_cells.sum())

    @pytest.mark.filterwarnings("error")
    def test_values_below_the_horizon_are_not_taken_for_colours(self, tmp_path: Path, few_cells: Tensor):
        """Of a table that rises towards the horizon, and goes on below it where the file is negative."""

        def f_r(w_i: Tensor, w_o: Tensor) -> Tensor:
            return torch.tensor([0.9, 0.5, 0.2]) * (1 + 0.3 / (w_i[..., 2:] * w_o[..., 2:] + 1e-3))

        MerlTable.from_function(f_r, "rising").save(tmp_path / "x.bsdf")
        found = tabulate(RGLMaterial.open(tmp_path / "x.bsdf"))
        assert found.negative < 1e-3
        assert found.clipped < 0.01
        assert bool((found.values[found.valid] > 0).any(-1).all())
        assert float(found.valid.sum()) > 0.9 * float(few_cells.sum())

    def test_black_is_measured(self, tmp_path: Path, few_cells: Tensor):
        MerlTable.from_function(lambda w_i, _: torch.zeros_like(w_i), "black").save(tmp_path / "x.bsdf")
        assert float(read_table(tmp_path / "x.bsdf").valid.sum()) > 0.9 * float(few_cells.sum())

    @pytest.mark.parametrize(("share", "said"), [(0.004, "less than 1%"), (0.006, "1%"), (0.22, "22%")])
    def test_colours_outside_rec_709_are_said_with_their_share(self, written, monkeypatch, share: float, said: str):
        path = written()
        found = replace(tabulate(RGLMaterial.open(path)), negative=share, clipped=0.05)
        monkeypatch.setattr("torchbrdf.brdf.rgl_table.tabulate", lambda _: found)
        with pytest.warns(UserWarning, match=rf"made\.bsdf: {said} of its cells have colours outside Rec\. 709, whose"):
            read_table(path)

    def test_cells_hold_the_mean_of_both_ways(self, written):
        """Of a material that reflects from left to right unlike from right to left; far from grazing."""
        path = written()
        material, table = RGLMaterial.open(path), MerlTable.from_bsdf(path)
        directions = from_half_difference(*cell_centres())
        steep = table.valid & (torch.stack(directions)[..., 2] > 0.4).all(0)
        steep[:20] = False  # cells that are cut into parts
        w_i, w_o = (each[steep].float() for each in directions)
        one, other, expected = evaluated(material, w_i, w_o), evaluated(material, w_o, w_i), table.values[steep]
        assert float(((one + other) / 2 - expected).norm() / expected.norm()) < 0.01
        assert float((one - expected).norm() / expected.norm()) > 0.1

    def test_written_files_open_in_mitsuba(self, tmp_path: Path, glossy: MerlTable):
        glossy.save(tmp_path / "x.bsdf")
        w_i, w_o = direction_pairs(2000, seed=3, lowest=0.2)
        found = bsdf_f_r(load_mitsuba(), {"type": "measured", "filename": str(tmp_path / "x.bsdf")}, w_i, w_o)
        wanted = glossy.lookup(w_i, w_o, "linear")
        assert float((found - wanted).norm() / wanted.norm()) < 0.01

    def test_what_was_not_measured_stays_so(self, tmp_path: Path, glossy: MerlTable):
        valid = glossy.valid.clone()
        valid[30:60, 20:40] = False
        MerlTable(glossy.values, valid, "holes").save(tmp_path / "x.bsdf")
        back = read_table(tmp_path / "x.bsdf").valid
        assert not back[33:57, 23:37].any()
        assert back[33:57, 43:60].any()

    def test_a_repeated_last_theta_i_was_not_measured(self, written):
        colours = fields()["rgb"]
        colours[:, -1] = colours[:, -2]
        assert RGLMaterial.open(written(rgb=colours)).last_measured == pytest.approx(1.2)

    def test_either_mark_of_what_was_measured(self, written):
        measured = np.ones((1, 5, NODES, NODES), bool)
        measured[..., -3:] = False
        one = MerlTable.from_bsdf(written(valid=np.packbits(measured)))
        other = MerlTable.from_bsdf(written(valid=np.packbits(~measured)))
        assert torch.equal(one.valid, other.valid)
        assert not one.valid[-10:].any()


class TestAnisotropic:
    @pytest.fixture
    def cells_as_a_whole(self, monkeypatch):
        """Those of sharp lobes, too: all azimuths of them in parts take long."""
        monkeypatch.setattr("torchbrdf.brdf.rgl_table._FINE_PARTS", 1)

    def test_is_refused(self, written):
        with pytest.raises(ValueError, match=r"made\.bsdf: anisotropic, measured for 9 azimuths, and a MERL table has"):
            read_table(written(azimuths=9))

    def test_mean_of_equal_azimuths_is_the_material(self, written, cells_as_a_whole):
        held = fields(4)
        alike = {name: np.repeat(held[name][:1], 4, 0) for name in ("rgb", "luminance")}
        vndf = np.ones_like(held["vndf"])
        found = read_table(written(azimuths=4, vndf=vndf, rgb=np.full_like(alike["rgb"], 0.5)), isotropic=True)
        one = read_table(written(vndf=vndf[:1], rgb=np.full_like(fields()["rgb"], 0.5)))
        torch.testing.assert_close(found.values, one.values, rtol=1e-4, atol=1e-4)

    def test_spread_is_said(self, written, cells_as_a_whole):
        colours = fields(4)["rgb"]
        colours[:2] *= 3
        with pytest.warns(UserWarning, match="its mean over all azimuths differs from it by"):
            read_table(written(azimuths=4, rgb=colours), isotropic=True)


def header(*parts: bytes) -> bytes:
    return b"tensor_file\0" + b"".join(parts)


def field(name: bytes, code: int, offset: int, *shape: int) -> bytes:
    packed = struct.pack(f"<HBQ{len(shape)}Q", len(shape), code, offset, *shape)
    return struct.pack("<H", len(name)) + name + packed


HOSTILE = {
    "other": (b"hello, world, here I am", "not an RGL .bsdf file of a measured material: it does not begin with"),
    "version": (header(b"\x02\x00"), "a tensor file of version 2.0; only 1.0 is read"),
    "cut": (header(b"\x01\x00\x05"), "truncated: it ends within its header"),
    "fields": (header(b"\x01\x00\xff\xff\xff\xff"), "truncated: it ends within its header"),
    "huge": (header(b"\x01\x00\x01\0\0\0", field(b"a", 10, 0, 1 << 60)), "does not fit the file's"),
    "product": (header(b"\x01\x00\x01\0\0\0", field(b"a", 10, 0, 1 << 32, 1 << 32)), "does not fit the file's"),
    "powers": (header(b"\x01\x00\x01\0\0\0", field(b"a", 10, 0, *[1 << 63] * 32)), "does not fit the file's"),
    "offset": (header(b"\x01\x00\x01\0\0\0", field(b"a", 10, 1 << 62, 1)), "does not fit the file's"),
    "type": (header(b"\x01\x00\x01\0\0\0", field(b"a", 77, 0, 1)), "the field 'a' has the unknown type 77"),
    "axes": (header(b"\x01\x00\x01\0\0\0", field(b"a", 1, 0, *[1] * 40)), "the field 'a' has 40 axes"),
    "empty": (header(b"\x01\x00\x01\0\0\0", field(b"a", 10, 0, 0, 1 << 63)), "is empty"),
    "twice": (header(b"\x01\x00\x02\0\0\0", 2 * field(b"a", 1, 0, 1)), "the field 'a' is there twice"),
    "missing": (header(b"\x01\x00\x01\0\0\0", field(b"a\n", 1, 0, 1)), r"has no field 'theta_i', only a\\n"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_containers_end_in_one_line(tmp_path: Path, kind: str):
    content, said = HOSTILE[kind]
    path = tmp_path / "x.bsdf"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=said.replace("(", r"\(")) as caught:
        read_table(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


BAD = {
    "theta_i": (np.array([0, 0.5, 0.4, 1.2, 1.5], np.float32), "must hold increasing angles"),
    "phi_i": (np.array([180], np.float32), "phi_i goes from 180 to 180, beyond a whole turn in radians"),
    "vndf": (np.zeros((1, 5, 16, 24), np.float32), "'vndf' is 0 for some direction"),
    "rgb": (np.full((1, 5, 3, NODES, NODES), np.nan, np.float32), "'rgb' is not finite"),
    "sigma": (np.zeros((2, 8), np.float32), "'sigma' is 0 somewhere"),
    "ndf": (np.ones((2, 8)), "'ndf' must be float32 with 2 axes, got float64"),
    "valid": (np.zeros(3, np.uint8), "'valid' has 24 bits"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_fields(written, name: str):
    value, said = BAD[name]
    with pytest.raises(ValueError, match=said):
        read_table(written(**{name: value}))


@pytest.mark.parametrize("unit", [1e-3, 10.0])
def test_wavelengths_in_another_unit(written, unit: float):
    spectra = np.ones((1, 5, 4, NODES, NODES), np.float32)
    wavelengths = np.float32(unit) * np.array([400, 500, 600, 700], np.float32)
    with pytest.raises(ValueError, match=r"do not reach from 460 to 620 nm"):
        read_table(written(("rgb",), spectra=spectra, wavelengths=wavelengths))


def test_spectra_without_wavelengths(written):
    with pytest.raises(ValueError, match="spectra without the field 'wavelengths'"):
        read_table(written(("rgb",), spectra=np.ones((1, 5, 4, NODES, NODES), np.float32)))


def test_container_there_and_back(tmp_path: Path):
    held = {"a": np.arange(6, dtype=np.float64).reshape(2, 3), "b": np.array([3], np.uint8)}
    write_tensor_file(tmp_path / "x", held)
    np.testing.assert_array_equal(TensorFile(tmp_path / "x", WHAT).read("a", "<f8", 2), held["a"])
