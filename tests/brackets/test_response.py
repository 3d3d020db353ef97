"""Responses: known ones are recognised, others found, and what does not fit shows."""

from pathlib import Path

import numpy as np
import pytest

from merge_cases import CURVES, Camera, texture
from torchbrdf.brackets.frames import Frame, clip_levels
from torchbrdf.brackets.registration import Motion
from torchbrdf.brackets.response import Curve, consistency, estimate
from torchbrdf.brackets.samples import Samples
from torchbrdf.images import SRGB, Shooting

TIMES = 0.02 * 3.0 ** np.arange(5)


def samples(curve: str) -> Samples:
    random = np.random.default_rng(0)
    shots = [Camera(curve).expose(texture(), time, random) for time in TIMES]
    frames = [Frame(Path("a.png"), codes, 255.0, "8-bit PNG", Shooting()) for codes in shots]
    return Samples.of(frames, [Motion()] * len(frames), clip_levels(frames))


@pytest.mark.parametrize("curve", ["srgb", "s-shaped"])
def test_a_curve_is_found_within_three_percent(curve):
    """From 10 codes of 255 on to where weights begin to fall; its scale is not known."""
    found = estimate(samples(curve), TIMES)
    codes = np.linspace(10, 215, 50) / 255
    linear = np.geomspace(1e-5, 1, 10_000)
    ratio = found.decode(codes, 0) / np.interp(codes, CURVES[curve](linear), linear)
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.03
    assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.01


def test_an_estimated_curve_rises_and_keeps_its_scale():
    found = estimate(samples("s-shaped"), TIMES)
    assert (np.diff(found.values) > 0).all()
    assert found.decode(np.array(0.5), 1) == pytest.approx(SRGB.decode(np.array(0.5)), rel=1e-3)


def test_frames_agree_under_their_own_curve_alone():
    taken = samples("srgb")
    assert consistency(Curve.of(SRGB), taken, TIMES).misfit < 0.01
    assert consistency(Curve.of(SRGB), taken, TIMES).bias < 0.03
    assert consistency(Curve.of(SRGB), samples("s-shaped"), TIMES).bias > 0.3


def test_a_wrong_time_shows_in_its_frame():
    wrong = TIMES * [1, 1, 1, 1.2, 1]
    found = consistency(Curve.of(SRGB), samples("srgb"), wrong).by_frame
    assert np.argmax(np.abs(found)) == 3
    assert found[3] < -0.05
