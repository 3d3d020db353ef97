"""Exposures from times, speeds and apertures: what counts, what rounds, what is refused."""

from pathlib import Path

import numpy as np
import pytest

from torchbrdf.brackets.exposures import Exposures
from torchbrdf.images import Shooting

PATHS = [Path("a.jpg"), Path("b.jpg")]


def of(*shootings: Shooting, times=None) -> Exposures:
    return Exposures.of(PATHS, shootings, times)


def test_time_speed_and_aperture_count():
    found = of(Shooting(0.01, 8.0, 100), Shooting(0.02, 4.0, 400))
    assert np.allclose(found.said, [0.01 / 64, 0.02 * 4 / 16])
    assert found.unit == "N^2 100/ISO 1/s"


def test_what_no_file_says_does_not_count():
    found = of(Shooting(0.01), Shooting(0.02))
    assert found.said.tolist() == [0.01, 0.02]
    assert found.unit == "1/s"


def test_times_that_are_given_count_as_they_are():
    found = of(Shooting(1 / 60), Shooting(), times=[1 / 60, 1 / 30])
    assert found.said.tolist() == found.exact.tolist() == [1 / 60, 1 / 30]


@pytest.mark.parametrize(
    ("shown", "exact"),
    [(1 / 60, 1 / 64), (1 / 125, 1 / 128), (1 / 13, 2 ** (-11 / 3)), (1 / 90, 2**-6.5), (30, 32), (1 / 1000, 2**-10)],
)
def test_cameras_round_times(shown, exact):
    assert of(Shooting(shown), Shooting(4.0)).exact[0] == pytest.approx(exact)


def test_a_time_that_is_no_stop_stays():
    assert of(Shooting(1 / 71), Shooting(4.0)).exact[0] == pytest.approx(1 / 71)


def test_apertures_round_too():
    found = of(Shooting(1.0, 5.6), Shooting(2.0, 11.0))
    assert np.allclose(found.exact, [1 / 32, 2 / 128])


@pytest.mark.parametrize(
    ("shootings", "times", "message"),
    [
        ([Shooting(0.1), Shooting()], None, r"^b\.jpg: says no exposure time \(EXIF\); give .*--times$"),
        ([Shooting(), Shooting()], [1.0], r"^--times needs one for every file, in their order: got 1 for 2 files$"),
        ([Shooting(0.1), Shooting(0.1)], None, r"^a\.jpg and the other 1 have the same exposure \(0\.1 s\)"),
        (
            [Shooting(0.1, iso=100), Shooting(0.2)],
            None,
            r"^b\.jpg: says no ISO speed \(EXIF\), and others of the set do",
        ),
        ([Shooting(0.1), Shooting(0.2, 8.0)], None, r"^a\.jpg: says no f-number"),
        ([Shooting(0.1), Shooting(0.0)], None, r"^b\.jpg: an exposure time of 0 s; give .*, above 0, .*--times$"),
        ([Shooting(), Shooting()], [0.0, 0.1], r"^a\.jpg: an exposure time of 0 s; give .*, above 0, .*--times$"),
        ([Shooting(), Shooting()], [0.1, -0.002], r"^b\.jpg: an exposure time of -0\.002 s; give"),
        ([Shooting(), Shooting()], [0.1, float("nan")], r"^b\.jpg: an exposure time of nan s; give"),
        ([Shooting(), Shooting()], [float("inf"), 0.1], r"^a\.jpg: an exposure time of inf s; give"),
    ],
)
def test_what_is_no_bracket(shootings, times, message):
    with pytest.raises(ValueError, match=message):
        of(*shootings, times=times)
