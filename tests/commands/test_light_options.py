"""`--probe` and the options beside it, as commands read them."""

import argparse
import re
from pathlib import Path

import pytest
import torch

from failures import assert_fit_fails, fails
from photographs_of_balls import photographed
from torchbrdf import LightProbe, write_image
from torchbrdf.commands._inputs import open_probe
from torchbrdf.commands._options import add_light
from torchbrdf.commands.live import _other_light, add_options
from torchbrdf.photograph import Circle

CIRCLE = (30.0, 21.0, 14.0)


@pytest.fixture(autouse=True)
def few_rows(monkeypatch):
    """What options say is the same of light in 64 rows, which the ball has not, as in 512."""
    monkeypatch.setattr("torchbrdf.light._picture.LEAST_HEIGHT", 64)


def parsed(*arguments: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_light(parser)
    return parser.parse_args(["--probe", *map(str, arguments)])


def distance(size: tuple[int, int]) -> torch.Tensor:
    """Of pixels from the middle of the ball."""
    y, x = torch.meshgrid(*(torch.arange(n) + 0.5 for n in size), indexing="ij")
    return torch.hypot(x - CIRCLE[0], y - CIRCLE[1])


@pytest.fixture
def photograph(tmp_path: Path) -> Path:
    """A mirror ball that is green at its right, before red."""
    size = (44, 64)
    inside = distance(size) <= CIRCLE[2]
    picture = torch.stack([(~inside).float(), torch.linspace(0, 1, 64).expand(size) * inside, 0.1 * inside])
    write_image(tmp_path / "ball.exr", picture)
    write_image(tmp_path / "mask.png", inside.float().expand(3, -1, -1))
    return tmp_path / "ball.exr"


BALL = ("--probe-layout", "mirror_ball")


def test_a_circle_says_where_the_ball_is(photograph):
    probe = open_probe(parsed(photograph, *BALL, "--probe-circle", *CIRCLE))
    assert probe.reading == "mirror ball, disc around (30, 21) of radius 14 pixels"
    assert float(probe.mean_radiance[0]) == 0


def test_a_mask_says_where_the_ball_is(photograph):
    """As well as the circle does, to half a pixel."""
    mask = photograph.with_name("mask.png")
    probe = open_probe(parsed(photograph, *BALL, "--probe-mask", mask))
    circle = open_probe(parsed(photograph, *BALL, "--probe-mask", mask, "--probe-circle", *CIRCLE))
    assert [float(n) for n in re.findall(r"[0-9.]+", probe.reading)] == pytest.approx(CIRCLE, abs=0.5)
    assert float(probe.mean_radiance[0]) == float(circle.mean_radiance[0]) == 0
    torch.testing.assert_close(probe.mean_radiance[1], circle.mean_radiance[1], rtol=0.02, atol=0)


def test_the_reflectance_is_divided_out(photograph):
    whole = open_probe(parsed(photograph, *BALL, "--probe-circle", *CIRCLE))
    for given, factor in (((0.5,), 2.0), ((1.0, 0.5, 1.0), 2.0)):
        found = open_probe(parsed(photograph, *BALL, "--probe-circle", *CIRCLE, "--mirror-reflectance", *given))
        assert float(found.mean_radiance[1] / whole.mean_radiance[1]) == pytest.approx(factor, rel=1e-6)


def test_a_mirror_ball_in_perspective(photograph):
    given = (*BALL, "--probe-circle", *CIRCLE)
    probe = open_probe(parsed(photograph, *given, "--probe-fov", 40))
    assert probe.reading.startswith("mirror ball, ball of ")
    assert "off the axis of a camera of 40 degrees across" in probe.reading
    assert float(probe.mean_radiance[0]) == 0


def test_a_near_camera_and_a_ball_from_infinity_are_a_warning(photograph):
    """The field of view is the photograph's: nothing says that the ball's picture has it, too."""
    options = parsed(photograph, *BALL, "--probe-circle", *CIRCLE)
    options.fov = 40.0
    with pytest.warns(UserWarning, match=r"--probe-fov DEG gives the horizontal field of view of the mirror ball"):
        open_probe(options)


def test_rows_from_pole_to_pole(tmp_path):
    radiance = torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(0))
    write_image(tmp_path / "probe.exr", radiance)
    assert torch.equal(open_probe(parsed(tmp_path / "probe.exr", "--probe-rows", "poles")).radiance, radiance)
    assert open_probe(parsed(tmp_path / "probe.exr")).reading == "rows at pixel centres"
    LightProbe(radiance).save(tmp_path / "probe.exr")
    assert torch.equal(open_probe(parsed(tmp_path / "probe.exr")).radiance, radiance)


@pytest.mark.parametrize(
    "option",
    [
        ("--probe-layout", "angular"),
        ("--probe-rows", "poles"),
        ("--probe-circle", 8, 8, 8),
        ("--probe-mask", "mask.png"),
        ("--mirror-reflectance", 0.5),
        ("--probe-fov", 40),
    ],
)
def test_the_default_probe_is_no_file(option):
    with pytest.raises(ValueError, match=f"^{option[0]} is for a probe from a file, and --probe is default$"):
        open_probe(parsed("default", *option))


def test_the_light_of_a_page_is_read_alike_and_named_by_its_options(tmp_path):
    parser = argparse.ArgumentParser()
    add_options(parser)
    picture = torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(0))
    write_image(tmp_path / "light.exr", picture)
    write_image(tmp_path / "square.exr", torch.ones(3, 8, 8))
    given = ["--probe-layout", "mirror_ball", "--probe-circle", "8", "8", "8", "--mirror-reflectance", "0.5", "--light"]
    found = _other_light(parser.parse_args([*given, str(tmp_path / "light.exr"), "--light-rows", "poles"]))
    assert torch.equal(found.radiance, picture)
    with pytest.raises(ValueError, match=r"give --light-layout mirror_ball or --light-layout angular \(.* in P"):
        _other_light(parser.parse_args([*given, str(tmp_path / "square.exr")]))
    with pytest.raises(ValueError, match=r"^--light-rows is for a probe from a file, and --light is default$"):
        _other_light(parser.parse_args([*given, "default", "--light-rows", "poles"]))


def test_the_embedded_probe_misspelt(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"^defaulx: no such file \(did you mean default\?\); expected a light"):
        open_probe(parsed("defaulx"))
    with pytest.raises(FileNotFoundError, match=r"ball\.exr: no such file; expected an image"):
        open_probe(parsed(tmp_path / "ball.exr"))


@pytest.fixture
def swapped(tmp_path: Path) -> tuple[Path, Path]:
    """A panorama and a photograph of a ball."""
    paths = tmp_path / "panorama.exr", tmp_path / "ball.exr"
    write_image(paths[0], LightProbe.default(64).radiance)
    write_image(paths[1], photographed((48, 64), [Circle(30, 22, 15)]))
    return paths


def test_photograph_and_probe_swapped(capsys, swapped, tmp_path):
    panorama, ball = swapped
    line = assert_fit_fails(capsys, tmp_path, panorama, "--probe", ball)
    assert line.split("error: ")[1] == (
        f"{panorama}: is twice as wide as high, as a light probe is, and that of --probe, {ball}, is not (48 x 64): "
        "they look swapped; give the ball as the photograph, and the panorama to --probe. If they are not, say what "
        "the probe is: --probe-layout"
    )
    assert "panorama.exr: is twice as wide" in fails(capsys, "live", panorama, "--probe", ball)


@pytest.mark.parametrize("more", [(), ("--probe-layout", "mirror_ball")])
def test_not_said_to_be_swapped(capsys, swapped, tmp_path, more):
    """Where the photograph is no panorama, or another layout is asked for."""
    panorama, ball = swapped
    files = (panorama, "--probe", ball, *more) if more else (ball, "--probe", ball)
    assert "look swapped" not in assert_fit_fails(capsys, tmp_path, *files)
