"""The weighted mean of frames, and what it says of pixels that none holds."""

from pathlib import Path

import numpy as np
import pytest

from torchbrdf.brackets.frames import Frame
from torchbrdf.brackets.merging import Radiance, merged
from torchbrdf.brackets.registration import Motion
from torchbrdf.brackets.response import Curve
from torchbrdf.images import Shooting
from torchbrdf.images.encodings import LINEAR

CLIPPED = slice(12, 20)
"""Columns that are too bright for both exposures."""


@pytest.fixture
def radiance() -> Radiance:
    """Of a short exposure, moved by 8 columns, and a longer one that is not."""
    scene = np.full((20, 40, 3), 0.3, dtype=np.float32)
    scene[:, CLIPPED] = 10.0
    scene[:, :4] = 1.5  # too bright for the longer one, beyond the border of the shorter one
    codes = [np.rint(np.clip(values, 0, 1) * 65535) for values in (np.roll(scene * 0.25, -8, 1), scene)]
    frames = [
        Frame(Path(f"{k}.tif"), one.astype(np.uint16), 65535.0, "16-bit TIFF", Shooting())
        for k, one in enumerate(codes)
    ]
    return merged(frames, [Motion(-8.0), Motion()], np.array([0.25, 1.0]), Curve.of(LINEAR), np.full(3, 0.98))


def test_what_the_shortest_shows_clipped_is_lost(radiance: Radiance) -> None:
    assert radiance.lost[:, CLIPPED].all()


def test_what_only_the_longer_shows_clipped_is_not(radiance: Radiance) -> None:
    assert np.isnan(radiance.values[:, :4]).all()
    assert not radiance.lost[:, :4].any()


def test_what_lies_beside_is_not(radiance: Radiance) -> None:
    assert radiance.lost.sum() == radiance.lost[:, CLIPPED].sum()
    assert radiance.bright > radiance.lost.sum()


def test_what_is_held_is_the_mean(radiance: Radiance) -> None:
    np.testing.assert_allclose(radiance.values[:, 24:30], 0.3, rtol=1e-3)
