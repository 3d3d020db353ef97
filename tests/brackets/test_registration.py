"""How the camera moved: found to a tenth of a pixel, between exposures that differ, or not at all."""

import numpy as np
import pytest

from merge_cases import Camera, moved, texture
from torchbrdf.brackets.registration import Motion, find_motion

SIZE = (160, 240)


def shot(radiance: np.ndarray, exposure: float, curve: str = "srgb", seed: int = 0) -> np.ndarray:
    codes = Camera(curve).expose(radiance, exposure, np.random.default_rng(seed))
    return codes[..., 1].astype(np.float32) / 255


@pytest.mark.parametrize("curve", ["srgb", "s-shaped"])
@pytest.mark.parametrize("motion", [(0.0, 0.0, 0.0), (0.4, -0.7, 0.0), (-9.3, 6.1, 0.5), (31.0, 12.5, -1.0)])
def test_a_shift_and_a_turn(curve, motion):
    scene = texture()
    found = find_motion(shot(scene, 0.1, curve), shot(moved(scene, *motion), 0.4, curve, 1))
    expected = Motion(motion[0], motion[1], np.radians(motion[2]))
    assert found.after(expected.inverse()).pixels(SIZE) < 0.1


def test_frames_that_do_not_overlap_in_tones_tell_nothing():
    assert find_motion(shot(texture(), 1e-5), shot(texture(), 10.0)) is None


def test_another_scene_does_not_match():
    with pytest.raises(LookupError):
        find_motion(shot(texture(), 0.1), shot(texture(seed=5), 0.4))


def test_motions_compose_and_invert():
    one, other = Motion(3.0, -2.0, 0.1), Motion(-1.0, 0.5, -0.3)
    matrices = [np.vstack([motion.matrix(SIZE), [0, 0, 1]]) for motion in (one, other, other.after(one))]
    assert np.allclose(matrices[1] @ matrices[0], matrices[2])
    assert one.inverse().after(one).pixels(SIZE) < 1e-12
