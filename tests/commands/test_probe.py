"""`torchbrdf probe`, from the command line to the file."""

import re
from pathlib import Path

import pytest
import torch

from failures import fails
from mirror_balls import BALL, photographed, room, scene
from probes import texel_directions
from torchbrdf import LightProbe, write_image
from torchbrdf.cli import main
from torchbrdf.commands._capture import NOT_GIVEN, REFLECTANCE_KEY
from torchbrdf.images import read_metadata
from torchbrdf.light.mirror.pixels import inside

SUN = torch.nn.functional.normalize(torch.tensor([0.6, 0.5, 0.6], dtype=torch.float64), dim=0)
CIRCLE = tuple(f"{each:.3f}" for each in BALL.circle)


@pytest.fixture(scope="module")
def chrome(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("photograph") / "chrome.exr"
    write_image(path, photographed(BALL))
    return path


def run(capsys, *arguments: object) -> tuple[int, str, str]:
    status = main(["probe", *(str(each) for each in arguments)])
    return status, *capsys.readouterr()


def test_a_photograph_becomes_a_probe(capsys, chrome, tmp_path):
    given = ("--fov", 30, "--circle", *CIRCLE, "--rows", 64, "--mirror-reflectance", 1)
    status, out, err = run(capsys, chrome, *given, "-o", tmp_path / "probe.exr")
    assert (status, err) == (0, "")
    x, y, radius = (float(each) for each in CIRCLE)
    place = f"at ({x:.1f}, {y:.1f}), radius {radius:.1f} pixels, as given, {BALL.off_axis_deg:.1f} degrees off the axis"
    assert place in out
    assert "the ball reflects 1 of the light" in out
    told = re.search(r"([0-9.]+)% of the sphere seen in the ball, ([0-9.]+)% beside it, and ([0-9.]+)%, behind it", out)
    assert told
    assert sum(float(each) for each in told.groups()) == pytest.approx(100, abs=0.2)
    probe = LightProbe.open(tmp_path / "probe.exr")
    expected = scene(texel_directions(64)).permute(2, 0, 1)
    assert float(((probe.radiance - expected).abs() * probe.solid_angles).sum() / probe.solid_angles.sum()) < 0.03
    assert probe.reading == "rows from pole to pole, as the file says"
    assert "degrees off the axis" in read_metadata(tmp_path / "probe.exr")["mirrorBall"]


def test_the_photograph_of_a_probe_is_no_photograph_of_a_material(capsys, chrome, tmp_path):
    """It explains itself, as something that reflects all light."""
    given = ("--fov", 30, "--circle", *CIRCLE)
    probe, out = tmp_path / "probe.exr", tmp_path / "out"
    assert run(capsys, chrome, *given, "--rows", 64, "--mirror-reflectance", 1, "-o", probe)[0] == 0
    line = fails(capsys, "fit", chrome, "--probe", probe, *given, "-o", out)
    assert line == (
        f"torchbrdf: error: {chrome}: this is the very photograph that the probe {probe} was made from, and it shows "
        "the mirror ball; give that of the ball of the material"
    )
    assert not out.exists()


def test_without_a_reflectance_there_is_a_warning(capsys, chrome, tmp_path):
    given = ("--fov", 30, "--circle", *CIRCLE, "--rows", 16)
    status, _, err = run(capsys, chrome, *given, "-o", tmp_path / "probe.exr", "--strict")
    assert status == 3
    assert "give --mirror-reflectance R or --metal NAME" in err
    assert read_metadata(tmp_path / "probe.exr")[REFLECTANCE_KEY] == NOT_GIVEN
    assert run(capsys, chrome, *given, "--mirror-reflectance", 0.6, "-o", tmp_path / "probe.exr")[0] == 0
    assert read_metadata(tmp_path / "probe.exr")[REFLECTANCE_KEY] == "the ball reflects 0.6 of the light"


def test_another_ball_than_a_mirror_is_a_warning(capsys, tmp_path):
    image = photographed(BALL, room)
    image[:, inside(BALL)] = 0.4
    write_image(tmp_path / "grey.exr", image)
    given = ("--fov", 30, "--circle", *CIRCLE, "--rows", 16, "--mirror-reflectance", 1)
    status, _, err = run(capsys, tmp_path / "grey.exr", *given, "-o", tmp_path / "probe.exr")
    assert status == 0
    assert "grey.exr: the ball looks matte" in err
    assert "so what is written is no light that a BRDF could be found under; give the photograph" in err


def test_what_is_hardly_a_metal_is_a_warning(capsys, chrome, tmp_path):
    given = ("--fov", 30, "--circle", *CIRCLE, "--rows", 16)
    for name, warned in (("MgO", True), ("Cr", False)):
        status, _, err = run(capsys, chrome, *given, "--metal", name, "-o", tmp_path / "probe.exr")
        assert status == 0
        assert ("is hardly a metal" in err) is warned


def test_the_same_photograph_twice_is_none_from_another_side(capsys, tmp_path):
    path = tmp_path / "chrome.exr"
    write_image(path, photographed(BALL, room))
    given = ("--fov", 30, "--circle", *CIRCLE, "--circle", *CIRCLE, "--rows", 64, "--mirror-reflectance", 1)
    status, out, err = run(capsys, path, path, *given, "-o", tmp_path / "probe.exr")
    assert status == 0
    assert "the second camera is turned by 0.0" in out
    assert "both photographs are from nearly the same side (0.0 degrees apart)" in err


def test_light_that_tells_no_rotation_is_refused(capsys, chrome, tmp_path):
    """It is brightest in one direction, and nearly the same all around that."""
    given = ("--fov", 30, "--circle", *CIRCLE, "--circle", *CIRCLE, "--rows", 64, "--mirror-reflectance", 1)
    status, _, err = run(capsys, chrome, chrome, *given, "-o", tmp_path / "probe.exr")
    assert status == 2
    assert "fit each other equally well in two ways: the light is too uniform to tell how the camera was turned" in err


def test_a_small_ball_leaves_a_guess(capsys, tmp_path):
    camera = BALL.camera
    ball = type(BALL)(camera, (0.0, 0.0, -1.0), 2.0)
    write_image(tmp_path / "chrome.exr", photographed(ball))
    given = ("--fov", 30, "--circle", *ball.circle, "--rows", 16, "--metal", "Al", "--no-surroundings")
    status, _, err = run(capsys, tmp_path / "chrome.exr", *given, "-o", tmp_path / "probe.exr")
    assert status == 0
    assert re.search(r"% of the light are a guess, continued from around; a second photograph from another side", err)


def test_pixels_of_no_exposure_are_told(capsys, tmp_path):
    image = photographed(BALL)
    x, y, _ = (int(each) for each in BALL.circle)
    image[:, y : y + 2, x : x + 3] = torch.nan
    write_image(tmp_path / "chrome.exr", image)
    given = ("--fov", 30, "--circle", *CIRCLE, "--rows", 16, "--mirror-reflectance", 1)
    status, _, err = run(capsys, tmp_path / "chrome.exr", *given, "-o", tmp_path / "probe.exr")
    assert status == 0
    assert "chrome.exr: 6 pixels of the ball hold no radiance (NaN) and are filled from around them; a lamp" in err


def test_a_lamp_too_bright_for_every_exposure_goes_on_to_the_alignment(capsys, tmp_path):
    image = photographed(BALL)
    x, y, _ = (int(each) for each in BALL.circle)
    image[:, y : y + 2, x : x + 3] = torch.inf
    write_image(tmp_path / "chrome.exr", image)
    given = ("--fov", 30, "--circle", *CIRCLE, "--rows", 64, "--mirror-reflectance", 1)
    status, _, err = run(capsys, tmp_path / "chrome.exr", *given, "-o", tmp_path / "probe.exr")
    assert status == 0
    assert "of the sphere, are infinite: a lamp too bright for every exposure. `torchbrdf fit --align`" in err
    with pytest.raises(ValueError, match=r"infinite texels? .* `torchbrdf fit --align` finds its radiance"):
        LightProbe.open(tmp_path / "probe.exr")
    lamps = LightProbe.open(tmp_path / "probe.exr", unknown_lamps=True).lamps
    assert lamps is not None
    assert lamps.unknown


def test_a_clipped_photograph_of_8_bits(capsys, tmp_path):
    whole = photographed(BALL, lambda d: 0.1 * room(d) + 50 * torch.exp(800 * (d.double() @ SUN - 1))[..., None])
    write_image(tmp_path / "chrome.png", whole)
    given = ("--fov", 30, "--circle", *CIRCLE, "--rows", 64, "--mirror-reflectance", 1)
    status, _, err = run(capsys, tmp_path / "chrome.png", "--allow-ldr", *given, "-o", tmp_path / "probe.exr")
    assert status == 0
    assert "pixels of the ball have its largest value and are clipped: taken as infinite" in err


def test_a_photograph_white_all_over(capsys, tmp_path):
    write_image(tmp_path / "chrome.exr", photographed(BALL, room).clamp_max(1.5))
    given = ("--fov", 30, "--circle", *CIRCLE, "--rows", 64, "--mirror-reflectance", 1)
    status, _, err = run(capsys, tmp_path / "chrome.exr", *given, "-o", tmp_path / "probe.exr")
    assert status == 0
    assert "% of the ball's pixels have its largest value, and look clipped: too many to be a lamp" in err


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((), "the camera's field of view is needed, and the file does not tell it: give --fov DEG, across the width"),
        (("--fov", 30, "--metal", "Al", "--mirror-reflectance", 0.9), "--metal and --mirror-reflectance say the same"),
        (("--fov", 30, "--metal", "Chrome"), "no metal 'Chrome' in Mitsuba's data; did you mean Cr?"),
        (("--fov", 30, "--mirror-reflectance", 60), "must be one or three numbers above 0 and at most 1, got 60"),
        (("--fov", 30, "--circle", 50, 50, 40, "--circle", 50, 50, 40), "--circle is given once for each photograph"),
        (("--fov", 30, "--metal", "Al", "--primaries", "rec2020"), "--metal is known in rec709 alone, got --primaries"),
    ],
)
def test_bad_options(capsys, chrome, tmp_path, given, message):
    status, out, err = run(capsys, chrome, *given, "-o", tmp_path / "probe.exr")
    assert (status, out) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_probe_is_exr(capsys, chrome, tmp_path):
    status, _, err = run(capsys, chrome, "--fov", 30, "-o", tmp_path / "probe.hdr")
    assert status == 2
    assert "probe.hdr: a light probe is saved as .exr; name it .exr" in err


def test_three_photographs_are_too_many(capsys, chrome, tmp_path):
    status, _, err = run(capsys, chrome, chrome, chrome, "--fov", 30, "-o", tmp_path / "probe.exr")
    assert status == 2
    assert "a mirror ball is unwrapped from one or two photographs, got 3" in err
