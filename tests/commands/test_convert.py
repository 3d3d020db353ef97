"""`torchbrdf convert`: what it writes, says and refuses."""

import json
from dataclasses import replace
from pathlib import Path

import OpenEXR
import pytest
import torch
from torch import Tensor

from failures import fails
from picture_files import rgb, write_exr
from torchbrdf.brdf.rgl import RGLMaterial
from torchbrdf.brdf.rgl_table import Tabulated, tabulate
from torchbrdf.brdf.tables import read_table
from torchbrdf.cli import main
from torchbrdf.images import (
    Shooting,
    exposure_for,
    png_bytes,
    read_image,
    read_metadata,
    read_picture,
    read_shooting,
    write_image,
)
from torchbrdf.light import LightProbe


def test_there_and_back(capsys, merl_directory: Path, tmp_path: Path):
    assert main(["convert", str(merl_directory / "red.binary"), str(tmp_path / "red.bsdf")]) == 0
    assert "for Mitsuba's RGB variants" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / "red.bsdf"), "-o", str(tmp_path / "red.binary")]) == 0
    assert "read again, it differs by l2 0.00%, log 0.00%, cube-root 0.00%" in capsys.readouterr().out
    assert read_table(tmp_path / "red.binary").valid.any()


def test_reading_it_again_says_nothing_by_a_temporary_name(capsys, monkeypatch, merl_directory: Path, tmp_path: Path):
    found = []

    def clipped(material: RGLMaterial) -> Tabulated:
        found.append(replace(tabulate(material), clipped=0.4))
        return found[-1]

    monkeypatch.setattr("torchbrdf.brdf.rgl_table.tabulate", clipped)
    assert main(["convert", str(merl_directory / "red.binary"), str(tmp_path / "again.bsdf"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    nothing = replace(found[0], valid=torch.zeros_like(found[0].valid))
    monkeypatch.setattr("torchbrdf.brdf.rgl_table.tabulate", lambda _: nothing)
    line = fails(capsys, "convert", merl_directory / "red.binary", tmp_path / "none.bsdf")
    assert line.startswith(f"torchbrdf: error: {tmp_path / 'none.bsdf'}: none of MERL's cells rests on what was")
    assert not (tmp_path / "none.bsdf").exists()


def test_other_suffixes(capsys, merl_directory: Path, tmp_path: Path):
    line = fails(capsys, "convert", merl_directory / "red.binary", tmp_path / "red.txt")
    given, out = merl_directory / "red.binary", tmp_path / "red.txt"
    assert line.endswith(f"{out}: {given} is a table, and tables are written as .binary or .bsdf; name the output so")
    line = fails(capsys, "convert", given, tmp_path / "red.png")
    assert line.endswith("name the output so; `torchbrdf render` makes a picture of it")


@pytest.mark.parametrize("named", [[], ["x.bsdf", "-o", "x.binary"]])
def test_one_file_to_write(capsys, merl_directory: Path, named: list[str]):
    assert fails(capsys, "convert", merl_directory / "red.binary", *named).endswith(
        "give one file to write, behind what is converted or with -o"
    )


def test_spectral_is_for_a_bsdf(capsys, merl_directory: Path, tmp_path: Path):
    line = fails(capsys, "convert", merl_directory / "red.binary", tmp_path / "x.binary", "--spectral")
    assert "--spectral is for a .bsdf file" in line


def test_a_broken_file_leaves_nothing(capsys, tmp_path: Path):
    (tmp_path / "x.bsdf").write_bytes(b"tensor_file\0\1\0\1")
    line = fails(capsys, "convert", tmp_path / "x.bsdf", tmp_path / "x.binary")
    assert "x.bsdf: truncated" in line
    assert not (tmp_path / "x.binary").exists()


@pytest.fixture
def radiance(tmp_path: Path) -> Tensor:
    """A ramp to 400 in `light.exr`, with a lamp that is too bright and a hole."""
    image = (400 * torch.linspace(0, 1, 20 * 40)).reshape(1, 20, 40) * torch.tensor([1.0, 0.8, 0.5])[:, None, None]
    image[:, 3, 4], image[1, 5, 6] = torch.inf, torch.nan
    write_image(tmp_path / "light.exr", image)
    return image


def test_a_picture_to_look_at(capsys, radiance: Tensor, tmp_path: Path):
    """Its 99th percentile is white, what is too bright, too, and what is no number black."""
    assert main(["convert", str(tmp_path / "light.exr"), str(tmp_path / "light.png"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    exposure = exposure_for(radiance, torch.isfinite(radiance).all(0, keepdim=True))
    assert 1 / 400 < exposure < 1 / 390
    assert told["exposure"] == pytest.approx(exposure)
    assert told["files"] == [str(tmp_path / "light.png")]
    shown = read_picture(tmp_path / "light.png", True).image
    assert shown[:, 3, 4].tolist() == [1, 1, 1]
    assert shown[1, 5, 6] == 0
    assert (tmp_path / "light.png").read_bytes() == png_bytes(radiance, exposure)


def test_the_exposure_is_said_and_may_be_given(capsys, radiance: Tensor, tmp_path: Path):
    """JPEG is lossy: of a ramp to a few steps of 255."""
    assert main(["convert", str(tmp_path / "light.exr"), "-o", str(tmp_path / "x.jpg"), "--exposure", "0.002"]) == 0
    odd = "1 of its pixels are too bright for a number, white; 1 of its pixels are not a number, black"
    assert capsys.readouterr().out == f"wrote {tmp_path / 'x.jpg'}; radiance times 0.002; {odd}\n"
    shown = read_picture(tmp_path / "x.jpg", True, encoding="gamma2.2").image
    torch.testing.assert_close(shown[:, 10:], 0.002 * radiance[:, 10:], rtol=0.1, atol=0.02)


def test_a_picture_to_another_linear_one(capsys, radiance: Tensor, tmp_path: Path):
    assert main(["convert", str(tmp_path / "light.exr"), str(tmp_path / "light.hdr")]) == 0
    assert capsys.readouterr().out == f"wrote {tmp_path / 'light.hdr'}\n"
    torch.testing.assert_close(read_image(tmp_path / "light.hdr")[:, 10:], radiance[:, 10:], rtol=0.02, atol=2)
    line = fails(capsys, "convert", tmp_path / "light.exr", tmp_path / "x.hdr", "--exposure", 2)
    assert "--exposure is of a picture to look at; name it X.png or X.jpg, or leave it out" in line


@pytest.mark.usefixtures("radiance")
@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["x.binary"], "(OpenEXR), and pictures are written as .png, .jpg, .exr or .hdr; name the output so"),
        (["x.png", "--spectral"], "error: --spectral is of a table: leave it out"),
        (["light.exr"], "the output is an input, which would be lost; give the output another name"),
    ],
)
def test_what_a_picture_is_not(capsys, tmp_path: Path, more: list[str], said: str):
    line = fails(capsys, "convert", tmp_path / "light.exr", tmp_path / more[0], *more[1:])
    assert line.endswith(said)


def test_what_a_table_is_not(capsys, merl_directory: Path, tmp_path: Path):
    given = merl_directory / "red.binary"
    line = fails(capsys, "convert", given, tmp_path / "x.bsdf", "--exposure", 2)
    assert line.endswith(f"--exposure is of a picture, and {given} is a table: leave it out")


@pytest.mark.usefixtures("radiance")
def test_a_picture_is_no_table(capsys, tmp_path: Path):
    """Of any command: it was said to have a bad header."""
    line = fails(capsys, "render", tmp_path / "light.exr", "--probe", "default", "-o", tmp_path / "x.png")
    assert line.endswith("light.exr: is a picture (OpenEXR), not a table; give one, .binary, .fullbin, .bsdf")


class TestWhatTheFileSays:
    """Beside its colours: it was dropped, and the rows of a probe were taken to lie elsewhere."""

    def test_a_light_probe_stays_one(self, capsys, tmp_path: Path):
        about = {"mirrorBallFov": "20", "mirrorBallReflectance": "not given", "mirrorBallPhotographs": "0a"}
        LightProbe(torch.rand(3, 8, 16)).save(tmp_path / "probe.exr", metadata=about)
        assert main(["convert", str(tmp_path / "probe.exr"), str(tmp_path / "x.exr")]) == 0
        assert capsys.readouterr().err == ""
        said = read_metadata(tmp_path / "x.exr")
        assert said == read_metadata(tmp_path / "probe.exr")
        assert said.items() >= (about | {"probeRows": "poles", "probeLamps": "known"}).items()

    def test_a_photograph_keeps_its_mask_and_camera(self, capsys, tmp_path: Path):
        shooting = Shooting(focal_mm=50.0, focal_35mm_mm=75.0, size=(80, 120), camera="Maker Model")
        alpha = (torch.rand(1, 8, 12) > 0.5).float()
        write_image(tmp_path / "a.exr", torch.rand(3, 8, 12), shooting.attributes(), alpha=alpha)
        assert main(["convert", str(tmp_path / "a.exr"), str(tmp_path / "x.exr")]) == 0
        assert capsys.readouterr().err == ""
        found = read_picture(tmp_path / "x.exr")
        assert torch.equal(found.alpha, alpha)
        assert torch.equal(found.image, read_image(tmp_path / "a.exr"))
        assert read_shooting(tmp_path / "x.exr") == shooting

    def test_an_environment_map_stays_one(self, tmp_path: Path):
        write_exr(tmp_path / "a.exr", rgb(torch.rand(3, 8, 16).numpy()), envmap=OpenEXR.ENVMAP_LATLONG)
        assert main(["convert", str(tmp_path / "a.exr"), str(tmp_path / "x.exr")]) == 0
        one, other = (LightProbe.open(tmp_path / name) for name in ("a.exr", "x.exr"))
        assert "its envmap attribute says" in other.reading
        assert torch.equal(one.radiance, other.radiance)

    def test_the_name_of_a_space_goes_with_the_colours_that_were_in_it(self, tmp_path: Path):
        """They are converted: the name would be wrong of them."""
        write_exr(tmp_path / "a.exr", rgb(torch.rand(3, 8, 8).numpy()), colorInteropID="lin_ap1_scene", comment="kept")
        assert main(["convert", str(tmp_path / "a.exr"), str(tmp_path / "x.exr")]) == 0
        assert read_metadata(tmp_path / "x.exr").items() >= {"comment": "kept"}.items()
        assert "colorInteropID" not in read_metadata(tmp_path / "x.exr")
        assert torch.equal(read_image(tmp_path / "x.exr"), read_image(tmp_path / "a.exr"))

    def test_what_an_hdr_cannot_hold(self, capsys, tmp_path: Path):
        LightProbe(torch.rand(3, 8, 16)).save(tmp_path / "probe.exr")
        assert main(["convert", str(tmp_path / "probe.exr"), str(tmp_path / "x.hdr")]) == 0
        lost = "a .hdr file does not hold how its rows lie (--probe-rows poles), that no lamp is clipped, which"
        (line,) = capsys.readouterr().err.splitlines()
        assert line == f"torchbrdf: warning: {tmp_path / 'x.hdr'}: {lost} {tmp_path / 'probe.exr'} does; name it X.exr"
        alpha = torch.eye(8)[None]
        write_image(tmp_path / "a.exr", torch.rand(3, 8, 8), {"nominalFocalLength": 50.0}, alpha=alpha)
        assert main(["convert", str(tmp_path / "a.exr"), str(tmp_path / "y.hdr")]) == 0
        lost = "the camera's field of view, alpha, which is a photograph's mask, which"
        assert lost in capsys.readouterr().err
        assert main(["convert", str(tmp_path / "a.exr"), str(tmp_path / "y.png")]) == 0
        assert capsys.readouterr().err == ""
