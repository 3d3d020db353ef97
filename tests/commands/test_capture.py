"""What `torchbrdf fit` says of a capture before it explains anything: unit, camera, clipped light."""

from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from torchbrdf.camera import PinholeCamera
from torchbrdf.camera.ball import Ball
from torchbrdf.commands._capture import FOV_KEY, NOT_GIVEN, REFLECTANCE_KEY, doubts_of_light, doubts_of_sight
from torchbrdf.images import write_image
from torchbrdf.light.probe import LightProbe
from torchbrdf.photograph import Circle, Observation


def sight(silhouette: object, size: tuple[int, int] = (60, 90), whole_numbers: bool = False) -> SimpleNamespace:
    full = torch.zeros(1, *size, dtype=torch.bool) if whole_numbers else None
    lit = torch.ones(3, 8, 8)
    photograph = SimpleNamespace(size=size, full=full)
    return SimpleNamespace(silhouette=silhouette, photograph=photograph, observation=Observation(lit, lit[:1] > 0))


def options(probe: object = "default", layout: str = "latlong", reflectance: list[float] | None = None) -> Namespace:
    read = {"probe_layout": layout, "mirror_reflectance": reflectance}
    return Namespace(photo=Path("ball.exr"), probe=str(probe), **read)


def topics(*arguments: object) -> list[str]:
    return [doubt.topic for doubt in doubts_of_sight(*arguments)]


def test_a_ball_in_a_wider_picture_has_a_camera_that_should_be_known():
    circle = Circle(50, 30, 20)
    (doubt,) = doubts_of_sight(options(), sight(circle))
    assert doubt.topic == "camera"
    assert doubt.text.startswith("ball.exr: neither --fov nor the file tells")
    assert topics(options(), sight(Ball.of_circle(PinholeCamera.of_fov((60, 90), 24.0), 50, 30, 20))) == []
    assert topics(options(), sight(None)) == []


@pytest.mark.parametrize(("circle", "said"), [((30, 30, 30), []), ((30.4, 30, 29.5), []), ((30, 30, 25), ["camera"])])
def test_a_crop_to_the_ball_has_none(circle, said):
    assert topics(options(), sight(Circle(*circle), (60, 60))) == said


def test_the_camera_of_the_probe_is_suggested(tmp_path):
    probe = tmp_path / "probe.exr"
    LightProbe.default(16).save(probe, metadata={FOV_KEY: "23.91"})
    (doubt,) = doubts_of_sight(options(probe), sight(Circle(30, 30, 30), (60, 60)))
    assert doubt.text.endswith("; the camera of its probe has one of 23.91 degrees, --fov 23.91")
    write_image(tmp_path / "other.exr", torch.ones(3, 8, 16))
    assert topics(options(tmp_path / "other.exr"), sight(Circle(30, 30, 30), (60, 60))) == []


def test_whole_numbers_have_no_unit_unless_an_alignment_looks_for_the_exposure():
    seen = sight(None, whole_numbers=True)
    assert topics(options(), seen) == ["no-unit"]
    assert topics(options(), seen, True) == []


def test_a_mirror_ball_of_which_nobody_says_what_it_reflects(tmp_path):
    """Under it every BRDF is too bright, whether `fit` reads the ball or a probe that was made from it."""
    (doubt,) = doubts_of_sight(options("chrome.exr", "mirror_ball"), sight(None))
    assert doubt.topic == "reflectance"
    assert doubt.text.startswith("chrome.exr: the mirror ball is taken to reflect all light")
    assert doubt.text.endswith("; give --mirror-reflectance R")
    assert topics(options("chrome.exr", "mirror_ball", [1.0]), sight(None)) == []
    assert topics(options("chrome.exr", "mirror_ball"), sight(None), True) == []  # an alignment looks for the factor
    for told, said in ((NOT_GIVEN, ["reflectance"]), ("the ball reflects 0.6 of the light", [])):
        LightProbe.default(16).save(tmp_path / "probe.exr", metadata={REFLECTANCE_KEY: told})
        assert topics(options(tmp_path / "probe.exr"), sight(None)) == said


@pytest.mark.parametrize(("black", "said"), [(0.0, []), (0.3, []), (1.0, ["negative"])])
def test_radiance_below_zero(black, said):
    seen = sight(None)
    seen.observation.image.copy_((torch.linspace(0, 4, 64).view(8, 8) - black).expand(3, -1, -1))
    assert topics(options(), seen) == said
    assert topics(options(), seen, True) == said
    if said:
        (doubt,) = doubts_of_sight(options(), seen)
        assert doubt.text.startswith("ball.exr: 25% of what it shows of the shape is below zero, down to -1 where")
    seen.observation.mask[:, :2] = False  # the sixteen darkest
    assert topics(options(), seen) == []


def clipped_sky(texels: int) -> LightProbe:
    radiance = 0.5 + torch.rand(3, 32, 64, generator=torch.Generator().manual_seed(0))
    radiance[:, 10, 20 : 20 + texels] = 30.0
    return LightProbe(radiance)


def test_clipped_lamps_are_doubtful_without_alignment():
    (doubt,) = doubts_of_light(clipped_sky(5), aligned=False)
    assert doubt.text == (
        "light probe: 5 texels of radiance 30 (row 10, columns 20 to 24, counted from 0), its brightest, look "
        "clipped; --align finds their radiance"
    )
    assert doubts_of_light(clipped_sky(5), aligned=True) == []


@pytest.mark.parametrize("probe", [clipped_sky(1), clipped_sky(2), LightProbe.default(64)])
def test_no_false_alarm(probe):
    assert doubts_of_light(probe, aligned=False) == []


@pytest.mark.parametrize("aligned", [False, True])
def test_light_that_is_clipped_as_a_whole_is_doubtful_whatever_is_aligned(aligned):
    (doubt,) = doubts_of_light(LightProbe(LightProbe.default(128).radiance.clamp_max(1.0)), aligned)
    assert doubt.topic == "clipped-light"
    assert "of the sphere has its largest value, 1, and looks clipped" in doubt.text
