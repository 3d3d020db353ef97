"""Simulated captures: scripts/make_captures.py and the package scripts/captures."""

import json
from dataclasses import replace
from fractions import Fraction
from math import atan, degrees, pi, radians, sin, tan
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import make_captures
import torchbrdf as tb
from captures import lights, plans, recording, scenes
from captures.placement import Frame, Placement, towards
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.images import read_image
from torchbrdf.light import rotation_of
from torchbrdf.light.latlong import directions_at
from turns import degrees_between

FRAME = Frame(48, 72, 24.0)
CORNER = Placement(towards(6.5, -3.5), 15.0)
BEHIND = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))


def plan_of(ball: Placement = CORNER, **changes: object) -> plans.Plan:
    (plan,) = plans.plans_of(["terracotta"], ["room"], 1, FRAME, seed=3, shift=0.0, alone=True)
    return replace(plan, ball=ball, aperture=0.0, **changes)


def tangents(ball: Placement, frame: Frame, count: int = 360) -> np.ndarray:
    """(count, 2): where rays that touch the ball meet the picture."""
    axis, alpha = np.array(ball.direction), radians(ball.radius_deg)
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    upward = np.cross(across, axis)
    t = np.linspace(0, 2 * pi, count, endpoint=False)[:, None]
    rays = np.cos(alpha) * axis + sin(alpha) * (np.cos(t) * across + np.sin(t) * upward)
    places = frame.focal * rays[:, :2] / -rays[:, 2:]
    return np.array([frame.width / 2, frame.height / 2]) + places * [1, -1]


# Placement


@pytest.mark.parametrize("ball", [CORNER, Placement(towards(-30, 20), 3.0), Placement(towards(0, 0), 15.0)])
def test_tangent_rays_meet_the_picture_on_the_ellipse(ball: Placement):
    frame = Frame(480, 720, 60.0)
    ellipse = ball.ellipse(frame)
    x, y = (tangents(ball, frame) - [ellipse.x, ellipse.y]).T
    turn = radians(ellipse.angle_deg)
    along, aside = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    np.testing.assert_allclose(np.hypot(along / ellipse.a, aside / ellipse.b), 1, rtol=1e-9)


def test_a_ball_on_the_axis_is_a_circle():
    ellipse = Placement(towards(0, 0), 15.0).ellipse(FRAME)
    radius = FRAME.focal * tan(np.arcsin(1 / 15))
    assert (ellipse.x, ellipse.y, ellipse.a, ellipse.b) == pytest.approx((36, 24, radius, radius))


def test_the_packages_camera_finds_the_same_ball_by_the_circle_of_the_truth():
    frame = Frame(480, 720, 60.0)
    camera = PinholeCamera.of_fov((frame.height, frame.width), frame.fov_deg)
    found = Ball.of_circle(camera, *CORNER.described(frame)["circle"])
    assert found.direction == pytest.approx(CORNER.direction, abs=1e-7)
    assert found.radius_deg == pytest.approx(CORNER.radius_deg, rel=1e-6)


def test_the_window_holds_the_ball_and_little_more():
    frame = Frame(480, 720, 24.0)
    rows, columns = CORNER.window(frame, margin=0)
    x, y = tangents(CORNER, frame).T
    found = (columns.start, columns.stop, rows.start, rows.stop)
    assert found == (np.floor(x.min()), np.ceil(x.max()), np.floor(y.min()), np.ceil(y.max()))


def test_a_widened_frame_is_of_the_same_camera():
    wide = FRAME.widened(10)
    assert wide.focal == pytest.approx(FRAME.focal)
    assert wide.fov_deg == pytest.approx(2 * degrees(atan(46 / FRAME.focal)))


# Plans


def test_no_family_of_materials_and_no_light_is_in_both_sets():
    families = [{name.split("_")[0] for name in names} for names in plans.MATERIALS.values()]
    assert not families[0] & families[1]
    assert not set(plans.PROBES["design"]) & set(plans.PROBES["report"])


@pytest.mark.parametrize("name", ["design", "report"])
def test_captures_go_through_all_materials_and_lights(name: str):
    drawn = plans.plans_of(plans.MATERIALS[name], plans.PROBES[name], 12, Frame(), 0, 0.0, False)
    assert {plan.material for plan in drawn} == set(plans.MATERIALS[name])
    assert {plan.probe for plan in drawn} == set(plans.PROBES[name])


@pytest.mark.parametrize("fov_deg", [12.0, 24.0, 50.0])
def test_balls_are_in_the_frame_and_mirror_balls_elsewhere(fov_deg: float):
    frame = Frame(480, 720, fov_deg)
    for plan in plans.plans_of(["a", "b"], ["c"], 8, frame, 0, 0.0, False):
        for ball in (plan.ball, plan.other_place):
            x, y = tangents(ball, frame).T
            assert min(x.min(), frame.width - x.max(), y.min(), frame.height - y.max()) > 0
        apart = np.hypot(plan.ball.ellipse(frame).x - plan.other_place.ellipse(frame).x, 0)
        assert apart > 10


def test_a_seed_draws_the_same_captures_and_another_others():
    drawn = [plans.plans_of(["a"], ["b"], 2, FRAME, seed, 0.0, False) for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]


# Lights


def test_the_sun_has_its_share_of_the_light_and_stands_in_its_direction(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(lights, "HEIGHT", 90)
    direction = plans.towards_sun(40, -60)
    found = lights.light_of(plan_of(sun=(direction, 0.4)), tb.LightProbe.default(32))
    without = lights.light_of(plan_of(sun=None), tb.LightProbe.default(32).resized(lights.HEIGHT))
    share = 1 - float(without.total_power.sum() / found.total_power.sum())
    assert share == pytest.approx(0.4, abs=1e-3)
    towards_it = torch.tensor([direction, (-direction[0], direction[1], direction[2])])
    at, beside = found.radiance_at(towards_it.float()).sum(1)
    assert at > 100 * beside


def test_clipping_reaches_the_factor_where_lamps_are_small():
    radiance = torch.ones(3, 64, 128)
    radiance[:, 20, 30] = 100
    probe = tb.LightProbe(radiance)
    found = lights.clipped(probe, 20)
    assert (found.limit, found.factor, found.texels) == pytest.approx((5, 20, 1))
    assert found.probe.radiance.max() == 5
    assert found.lost == pytest.approx(1 - float(found.probe.total_power.sum() / probe.total_power.sum()))


def test_skies_are_not_clipped():
    radiance = torch.ones(3, 64, 128)
    radiance[:, :32] = 2
    radiance[:, 20, 30] = 100
    found = lights.clipped(tb.LightProbe(radiance), 1000)
    assert found.limit == 2


def test_the_misturned_probe_is_two_degrees_off():
    plan = plan_of()
    assert degrees(np.linalg.norm(plan.misturn)) == pytest.approx(2)
    light = lights.light_of(plan, tb.LightProbe.default(32))
    turn = rotation_of(torch.tensor(plan.misturn, dtype=torch.float64))
    assert degrees_between(turn, torch.eye(3, dtype=torch.float64)) == pytest.approx(2, abs=1e-6)
    assert torch.equal(lights.misturned(plan, light).radiance, light.rotated(turn).radiance)


# Recording


@pytest.mark.parametrize("response", recording.RESPONSES)
def test_a_response_rises_from_0_to_1_and_saturates(response: str):
    stored = recording.respond(np.linspace(-0.1, 1.1, 1201), response)
    assert stored[:100].max() == 0
    assert stored[1100:].min() == pytest.approx(1)
    assert (np.diff(stored[100:1101]) > 0).all()


def test_medium_grey_of_srgb_is_118():
    assert round(255 * float(recording.respond(np.array(0.18), "srgb"))) == 118


def test_the_noise_of_the_photograph_is_1_percent_at_the_level_and_less_relative_to_highlights():
    generator = np.random.default_rng(0)
    at, bright = (recording.noisy(torch.full((3, 200, 200), 2.0 * k), 2.0, generator) / (2 * k) for k in (1, 100))
    assert float(at.std()) == pytest.approx(0.01, rel=0.02)
    assert float(bright.std()) == pytest.approx(0.001, rel=0.02)


def test_brackets_reach_from_unclipped_highlights_to_bright_shadows_and_all_but_one_move():
    image = torch.linspace(0.01, 300, 3 * 40 * 40).view(3, 40, 40)
    found = recording.brackets_of(image, image[:, 0], 1.0, 3.0, np.random.default_rng(0))
    assert [one.stops for one in found] == sorted(one.stops for one in found)
    assert 300 * 0.18 * 2.0 ** found[0].stops < 1
    moved = [one.moved != (0.0, 0.0) for one in found]
    assert moved.count(False) == 1
    assert max(abs(number) for one in found for number in one.moved) <= 3


def test_a_bracket_is_grey_at_the_base_time_and_brighter_by_stops():
    image = torch.full((3, 30, 30), 5.0)
    means = [
        recording.recorded(image, 5.0, recording.Exposure(k), "srgb", 0, np.random.default_rng(0)).mean()
        for k in (-2, 0, 5)
    ]
    expected = [255 * float(recording.respond(np.array(0.18 * 2.0**k), "srgb")) for k in (-2, 0, 5)]
    assert means == pytest.approx(expected, abs=0.3)


def test_a_moved_bracket_shows_the_picture_moved_to_the_right_and_down():
    image = torch.zeros(3, 24, 24)
    image[:, 10, 8] = 1
    exposure = recording.Exposure(0, (3.0, 2.0))
    pixels = recording.recorded(image, 1.0, exposure, "srgb", 4, np.random.default_rng(0))
    assert pixels.shape == (16, 16, 3)
    assert np.unravel_index(pixels.sum(2).argmax(), (16, 16)) == (10 + 2 - 4, 8 + 3 - 4)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_exif_holds_the_time_and_the_lens(suffix: str, tmp_path: Path):
    path = tmp_path / f"one{suffix}"
    recording.write_bracket(path, np.full((8, 12, 3), 99, np.uint8), recording.Exposure(-4), 24.0)
    with Image.open(path) as picture:
        exif = picture.getexif().get_ifd(0x8769)
        assert np.abs(np.asarray(picture, dtype=int) - 99).max() <= 1
    assert Fraction(exif[0x829A]) == Fraction(1, 960)
    assert 2 * degrees(atan(18 / exif[0xA405])) == pytest.approx(24, abs=0.15)
    assert 2 * degrees(atan(23.5 / 2 / float(exif[0x920A]))) == pytest.approx(24, abs=0.01)


# Pictures


def test_the_pictures_ball_is_the_ellipse(mitsuba):
    probe = tb.LightProbe(torch.ones(3, 8, 16))
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}}
    image = scenes.CaptureScene(mitsuba, plan_of(), probe, CORNER, black).render(FRAME, 256, seed=0)
    covered = 1 - image[0].double()
    y, x = torch.meshgrid(torch.arange(48) + 0.5, torch.arange(72) + 0.5, indexing="ij")
    ellipse = CORNER.ellipse(FRAME)
    assert float(covered.sum()) == pytest.approx(pi * ellipse.a * ellipse.b, rel=3e-3)
    middle = [float((covered * at).sum() / covered.sum()) for at in (x, y)]
    assert middle == pytest.approx([ellipse.x, ellipse.y], abs=0.03)


def test_background_and_mirror_ball_show_the_probe_where_it_is(mitsuba):
    y, x = torch.meshgrid(torch.arange(32.0), torch.arange(64.0), indexing="ij")
    probe = tb.LightProbe(1 + 0.9 * directions_at(x, y, 32, 64).permute(2, 0, 1))  # +X is red, +Y green, +Z blue
    image = scenes.CaptureScene(mitsuba, plan_of(), probe, CORNER, scenes.CHROME).render(FRAME, 64, seed=0)
    left_top = torch.tensor([(2.5 - 36) / FRAME.focal, (24 - 2.5) / FRAME.focal, -1.0])
    background = probe.radiance_at(left_top / left_top.norm())
    torch.testing.assert_close(image[:, 2, 2], background, rtol=0.02, atol=0)
    column, row = tangents(CORNER, FRAME).mean(0).astype(int)
    mirrored = probe.radiance_at(-torch.tensor(CORNER.direction))
    torch.testing.assert_close(image[:, row, column], mirrored, rtol=0.05, atol=0)


def test_60_percent_are_reflected(mitsuba):
    probe = tb.LightProbe(torch.ones(3, 8, 16))
    image = scenes.CaptureScene(mitsuba, plan_of(), probe, CORNER, scenes.CHROME_60).render(FRAME, 4, seed=0)
    x, y = (tangents(CORNER, FRAME).mean(0)).astype(int)
    torch.testing.assert_close(image[:, y, x], torch.full((3,), 0.6), rtol=1e-4, atol=0)


def test_surroundings_hide_little_of_the_light(mitsuba):
    plan = replace(plan_of(), alone=False)
    light = tb.LightProbe(torch.ones(3, 8, 16))
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1}}
    image = scenes.CaptureScene(mitsuba, plan, light, CORNER, white).render(FRAME, 64, seed=0)
    rows, columns = CORNER.window(FRAME, margin=-3)
    assert float(image[:, rows, columns].mean()) == pytest.approx(1, abs=0.04)
    assert float(image.std()) > 0.05  # yet they are there


# The script


TINY = ["--set", "analytic", "--count", "1", "--size", "32", "48", "--samples", "4", "--ball-samples", "4"]
TINY += ["--ideal-size", "10", "--target-samples", "16"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from torchbrdf.mitsuba_startup.loading import MitsubaUnavailableError, load_mitsuba

    try:
        load_mitsuba()
    except MitsubaUnavailableError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("captures")
    assert make_captures.main([*TINY, "--shift", "2", "-o", str(folder)]) == 0
    return folder


@pytest.fixture
def capture(made: Path) -> Path:
    return next(made.glob("*/truth.json")).parent


def test_a_capture_holds_what_its_truth_names(capture: Path):
    truth = json.loads((capture / "truth.json").read_text())
    brackets = [one["file"] for name in ("photo", "chrome") for one in truth[f"{name}_brackets"]]
    named = {*brackets, "truth.json", "photo.exr", "chrome.exr", "chrome60.exr", "ideal.exr", "ideal_clean.exr"}
    named |= {"probe.exr", "probe_turned.exr", "probe_clipped.exr"}
    assert {path.name for path in capture.iterdir()} == named
    assert read_image(capture / "photo.exr").shape == (3, 32, 48)


def test_the_probe_that_is_written_is_the_light(capture: Path):
    truth = json.loads((capture / "truth.json").read_text())
    assert tb.LightProbe.open(capture / "probe.exr").fingerprint == truth["probe_fingerprint"]
    expected = tb.LightProbe.default().rotated(torch.tensor(truth["rotation"], dtype=torch.float64))
    assert expected.fingerprint == truth["probe_fingerprint"]


def test_targets_are_there_for_every_light(made: Path):
    assert {path.stem for path in (made / "lights").iterdir()} == {"room", "back", "below"}
    assert len(list((made / "targets").glob("*/*.exr"))) == 3


def test_the_same_command_makes_nothing_anew_and_another_seed_does(made: Path, capture: Path):
    before = (capture / "truth.json").stat().st_mtime_ns
    assert make_captures.main([*TINY, "--shift", "2", "-o", str(made)]) == 0
    assert (capture / "truth.json").stat().st_mtime_ns == before


def test_the_same_seed_makes_the_same_photograph(capture: Path, tmp_path: Path):
    assert make_captures.main([*TINY, "--shift", "2", "--no-targets", "-o", str(tmp_path)]) == 0
    again = read_image(tmp_path / capture.name / "photo.exr")
    torch.testing.assert_close(again, read_image(capture / "photo.exr"), rtol=1e-5, atol=1e-7)


def test_data_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert make_captures.main(["--data", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert str(tmp_path / "rgl") in capsys.readouterr().err
