"""Which camera a photograph is by: the options, what its file says, and where they disagree."""

import argparse
from pathlib import Path

import pytest
import torch

from torchbrdf import write_image
from torchbrdf.cli import main
from torchbrdf.commands._inputs import open_camera
from torchbrdf.commands._options import add_camera, number
from torchbrdf.images import Shooting

SIZE = (40, 60)
TAKEN = Shooting(focal_mm=50.0, focal_35mm_mm=75.0, size=SIZE)
FOV = 26.99
"""Of a picture by a focal length of 75 mm in 35 mm film."""


def parsed(*arguments: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--fov", type=number(0, 180))
    add_camera(parser)
    return parser.parse_args([str(each) for each in arguments])


def saved(path: Path, shooting: Shooting, size: tuple[int, int] = SIZE) -> Path:
    write_image(path, torch.rand(3, *size), shooting.attributes())
    return path


def test_the_file_tells_the_camera(tmp_path):
    camera, told = open_camera(parsed(), saved(tmp_path / "a.exr", TAKEN), SIZE)
    assert camera is not None
    assert camera.fov_deg == pytest.approx(FOV, abs=0.1)
    assert told == "by what the file says"


def test_a_file_that_does_not_know_its_original_is_taken_as_whole(tmp_path):
    shooting = Shooting(focal_mm=50.0, focal_35mm_mm=75.0)
    _, told = open_camera(parsed(), saved(tmp_path / "a.exr", shooting), SIZE)
    assert told == "by what the file says, taken as whole"


def test_a_smaller_picture_may_be_a_crop(tmp_path):
    path = saved(tmp_path / "a.exr", TAKEN, (20, 30))
    with pytest.warns(UserWarning, match=r"is 20 x 30 and was 40 x 60 .* read as resized; if it is cropped, give"):
        camera, _ = open_camera(parsed(), path, (20, 30))
    assert camera is not None
    assert camera.fov_deg == pytest.approx(FOV, abs=0.1)


@pytest.mark.parametrize("given", [("--fov", 40), ("--focal-mm", 50, "--sensor-mm", 36)])
def test_options_that_the_file_denies_are_taken_with_a_warning(tmp_path, given):
    path = saved(tmp_path / "a.exr", TAKEN)
    with pytest.warns(UserWarning, match=r"camera of 26\.\d+ degrees across as its file says, and by one of \d"):
        camera, told = open_camera(parsed(*given), path, SIZE)
    assert camera is not None
    assert camera.fov_deg != pytest.approx(FOV, abs=0.5)
    assert told == "as given"


def test_options_that_the_file_confirms_are_no_warning(tmp_path, recwarn):
    open_camera(parsed("--fov", 26), saved(tmp_path / "a.exr", TAKEN), SIZE)
    assert not recwarn.list


def test_a_circle_outside_the_photograph(tmp_path, capsys):
    path = saved(tmp_path / "a.exr", TAKEN)
    status = main(["fit", str(path), "--circle", "150", "20", "10", "--probe", "default", "-o", str(tmp_path / "out")])
    assert status == 2
    assert "is outside the photograph, which is 60 wide and 40 high" in capsys.readouterr().err
