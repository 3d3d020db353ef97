"""What is done to frames before they are merged."""

import numpy as np

from torchbrdf.brackets.merging import _Moved
from torchbrdf.brackets.registration import Motion


def test_nothing_rings_around_a_lamp_that_moved():
    plane = np.ones((20, 20), np.float32)
    plane[8:12, 8:12] = 1e4
    moved = _Moved(Motion(0.3, 0.2), (20, 20))(plane, values=True)
    assert moved.min() > 0
    assert moved.max() > 0.9e4
