"""From directions to pixels and back, against OpenCV."""

import cv2
import numpy as np
import pytest
import torch

from torchbrdf.camera import PinholeCamera

SIZE = (48, 72)
LENS = (-0.2, 0.05, 1e-3, -2e-3, 0.01)


def places() -> torch.Tensor:
    x, y = torch.meshgrid(
        torch.linspace(0, 72, 9, dtype=torch.float64), torch.linspace(0, 48, 7, dtype=torch.float64), indexing="ij"
    )
    return torch.stack([x, y], -1)


def opencv_places(camera: PinholeCamera, directions: torch.Tensor) -> np.ndarray:
    """By OpenCV, whose camera looks along +Z with y down and counts from the middle of the first pixel."""
    x, y = (axis - 0.5 for axis in camera.axis)
    matrix = np.array([[camera.focal, 0, x], [0, camera.focal, y], [0, 0, 1]])
    points = directions.reshape(-1, 3).numpy() * (1, -1, -1)
    found, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(camera.distortion or (0.0,) * 4))
    return found.reshape(*directions.shape[:-1], 2) + 0.5


def test_the_middle_looks_along_minus_z_and_the_right_border_half_the_field_of_view_to_the_right():
    camera = PinholeCamera.of_fov(SIZE, 60)
    middle, right = camera.rays(torch.tensor([[36.0, 24.0], [72.0, 24.0]], dtype=torch.float64))
    assert middle.tolist() == [0, 0, -1]
    assert torch.allclose(right, torch.tensor([0.5, 0, -(0.75**0.5)], dtype=torch.float64))


def test_up_in_the_photograph_is_plus_y():
    assert PinholeCamera.of_fov(SIZE, 60).rays(torch.tensor([36.0, 0.0]))[1] > 0


@pytest.mark.parametrize(
    "lens", [(), LENS, LENS[:4], (*LENS, 0.1, 0.02, 0.003), (*LENS, 0.1, 0.02, 0, 1e-3, 0, 2e-3, 0)]
)
@pytest.mark.parametrize("principal", [None, (30.0, 25.5)])
def test_places_are_those_of_opencv(lens: tuple[float, ...], principal: tuple[float, float] | None):
    camera = PinholeCamera.of_fov(SIZE, 50, principal, lens)
    rays = camera.rays(places())
    assert np.abs(opencv_places(camera, rays) - places().numpy()).max() < 1e-6
    assert torch.allclose(camera.project(3 * rays), places(), atol=1e-6)


def test_a_lens_in_inference_mode():
    alone = PinholeCamera.of_fov(SIZE, 50, None, LENS).rays(places())
    with torch.inference_mode():
        within = PinholeCamera.of_fov(SIZE, 50, None, LENS).rays(places())
    assert torch.equal(within, alone)


def test_a_sensor_spans_the_longer_side():
    for size in (SIZE, SIZE[::-1]):
        assert PinholeCamera.of_focal(size, 50, 36).focal == 72 * 50 / 36


def test_the_field_of_view_is_kept():
    assert PinholeCamera.of_fov(SIZE, 24).fov_deg == pytest.approx(24)


def test_what_lies_behind_is_nowhere():
    assert PinholeCamera.of_fov(SIZE, 24).project(torch.tensor([0.1, 0.2, 1.0])).isnan().all()


def test_a_place_that_is_none_has_no_ray_and_spoils_no_other():
    camera = PinholeCamera(SIZE, 80.0, distortion=LENS)
    known = torch.tensor([[30.0, 20.0]])
    rays = camera.rays(torch.cat([torch.full((1, 2), torch.nan), known]))
    assert rays[0].isnan().all()
    assert torch.allclose(rays[1], camera.rays(known)[0])


@pytest.mark.parametrize("lens", [(-2.0, 0, 0, 0), (0, -3.0, 0, 0)])
def test_a_lens_that_folds_the_photograph_is_refused(lens: tuple[float, ...]):
    with pytest.raises(ValueError, match="folds the photograph over"):
        PinholeCamera.of_fov(SIZE, 60, distortion=lens)


@pytest.mark.parametrize("lens", [(0.1,), (0.1, 0, 0, 0, 0, 0), (float("nan"), 0, 0, 0)])
def test_other_coefficients_are_refused(lens: tuple[float, ...]):
    with pytest.raises(ValueError, match="4, 5, 8 or 12 finite coefficients"):
        PinholeCamera.of_fov(SIZE, 60, distortion=lens)


def test_senseless_cameras_are_refused():
    for wrong in (
        lambda: PinholeCamera.of_fov(SIZE, 180),
        lambda: PinholeCamera.of_focal(SIZE, 0, 36),
        lambda: PinholeCamera(SIZE, float("nan")),
        lambda: PinholeCamera((0, 10), 50),
        lambda: PinholeCamera((48.5, 72), 50),  # type: ignore[arg-type]
        lambda: PinholeCamera((48, 72, 3), 50),  # type: ignore[arg-type]
        lambda: PinholeCamera(SIZE, 50, (73, 0)),
    ):
        with pytest.raises(ValueError, match="must"):
            wrong()
