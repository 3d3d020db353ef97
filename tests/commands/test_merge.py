"""`torchbrdf merge` from files to a file, and what it says."""

from argparse import ArgumentTypeError

import pytest
import torch

from failures import fails
from merge_cases import Camera, bracket, texture
from torchbrdf.cli import main
from torchbrdf.commands.merge import seconds
from torchbrdf.images import read_image

TIMES = [0.02, 0.08, 0.32]


@pytest.fixture
def files(tmp_path):
    return [str(path) for path in bracket(tmp_path, texture(decades=2.0), TIMES, Camera())]


def test_a_bracket_becomes_a_picture(capsys, tmp_path, files):
    assert main(["merge", *files, "-o", str(tmp_path / "ball.exr"), "--strict"]) == 0
    said = capsys.readouterr().out
    assert "3 exposures over a range of 16; response sRGB, as the files say" in said
    assert "all 38400 pixels are held" in said
    assert torch.isfinite(read_image(tmp_path / "ball.exr")).all()


def test_options_reach_the_method(capsys, tmp_path, files):
    out = str(tmp_path / "probe.exr")
    options = ["--times", "1/50", "2/25", "0.32", "--response", "srgb", "--still", "--primaries", "aces-ap1"]
    assert main(["merge", *files, *options, "-o", out]) == 0
    assert "response sRGB, as given" in capsys.readouterr().out
    assert main(["merge", *files, "--like", out, "-o", str(tmp_path / "ball.exr")]) == 0
    assert f"response sRGB, as {out} has it" in capsys.readouterr().out
    pictures = [read_image(tmp_path / name, primaries="aces-ap1") for name in ("probe.exr", "ball.exr")]
    assert torch.allclose(*pictures, rtol=1e-5)


def test_bad_input_is_one_line_and_no_file(capsys, tmp_path, files):
    out = tmp_path / "ball.exr"
    assert "merge needs two exposures or more, got 1" in fails(capsys, "merge", files[0], "-o", out)
    assert "is an .exr file" in fails(capsys, "merge", *files, "-o", tmp_path / "ball.png")
    line = fails(capsys, "merge", *files, "--times", "1", "2", "-o", out)
    assert "--times needs one for every file, in their order: got 2 for 3 files" in line
    assert not out.exists()


@pytest.mark.parametrize(("text", "expected"), [("1/60", 1 / 60), ("0.5", 0.5), ("30", 30.0), ("2/5", 0.4)])
def test_times_as_cameras_show_them(text, expected):
    assert seconds(text) == pytest.approx(expected)


@pytest.mark.parametrize("text", ["0", "-1", "1/0", "a", "1/2/3", "inf", ""])
def test_what_is_no_time(text):
    with pytest.raises(ArgumentTypeError, match="must be a finite number above 0"):
        seconds(text)
