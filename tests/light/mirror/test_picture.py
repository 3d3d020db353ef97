"""Mirror balls in perspective as a layout of `LightProbe.open`."""

import pytest

from mirror_balls import BALL, photographed, scene
from probes import texel_directions
from torchbrdf import LightProbe, write_image
from torchbrdf.camera import Ball, PinholeCamera


def difference(probe: LightProbe) -> float:
    """From the scene: mean over the sphere, relative."""
    expected = scene(texel_directions(probe.height)).permute(2, 0, 1)
    off = ((probe.radiance - expected).abs() * probe.solid_angles).sum()
    return float(off / (expected * probe.solid_angles).sum())


def test_a_tight_crop_of_a_near_camera(tmp_path):
    """As `fit --fov` takes it: the field of view across the crop."""
    camera = PinholeCamera.of_fov((96, 96), 40)
    write_image(tmp_path / "crop.exr", photographed(Ball(camera, (0, 0, -1), 20.0)))
    probe = LightProbe.open(tmp_path / "crop.exr", "mirror_ball", height=64, fov_deg=40)
    infinity = LightProbe.open(tmp_path / "crop.exr", "mirror_ball", height=64)
    assert difference(probe) < 0.015
    assert difference(infinity) > 0.05
    assert probe.reading.startswith(
        "mirror ball, ball of 40.000 degrees at (48.0, 48.0), radius 48.0 pixels, 0.0 degree"
    )


def test_a_circle_in_a_whole_photograph(tmp_path):
    write_image(tmp_path / "whole.exr", photographed(BALL))
    probe = LightProbe.open(tmp_path / "whole.exr", "mirror_ball", height=64, circle=BALL.circle, fov_deg=30)
    assert difference(probe) < 0.015


def test_the_field_of_view_is_of_mirror_balls(tmp_path):
    write_image(tmp_path / "map.exr", scene(texel_directions(8)).permute(2, 0, 1))
    with pytest.raises(ValueError, match=r"--probe-fov \(fov_deg= in Python\) goes with --probe-layout mirror_ball"):
        LightProbe.open(tmp_path / "map.exr", fov_deg=40)
