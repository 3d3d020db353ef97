from math import cos, log, pi, tan

import pytest
import torch

from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.brdf.directions import half_difference


def of_half_angle(theta_h: float, dtype: torch.dtype = torch.float64) -> ShadingGeometry:
    angles = torch.tensor([theta_h], dtype=dtype)
    return ShadingGeometry.of_angles(angles, torch.zeros_like(angles), torch.zeros_like(angles))


@pytest.mark.parametrize("theta_h", [1e-5, 0.01, 0.7, 0.9, 1.5])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_functions_of_the_half_angle_keep_their_digits(theta_h: float, dtype: torch.dtype):
    geometry = of_half_angle(theta_h, dtype)
    digits = 1e-5 if dtype == torch.float32 else 1e-10
    stored = float(torch.tensor(theta_h, dtype=dtype))
    assert float(geometry.tan2_h) == pytest.approx(tan(stored) ** 2, rel=digits)
    logarithm, versine = log(cos(stored)), 1 - cos(stored)
    if theta_h < 1e-3:
        logarithm, versine = -(stored**2) / 2, stored**2 / 2
    assert float(geometry.log_cos_h) == pytest.approx(logarithm, rel=digits)
    assert float(geometry.versine_h) == pytest.approx(versine, rel=digits)


def test_functions_of_the_half_angle_are_finite_at_the_horizon():
    geometry = of_half_angle(pi / 2)
    assert 0 < float(geometry.tan2_h) <= 1e12
    assert float(geometry.log_cos_h) == pytest.approx(log(1e-6))


def test_of_directions_and_of_angles_agree():
    generator = torch.Generator().manual_seed(2)
    w = torch.nn.functional.normalize(torch.randn(2, 50, 3, generator=generator, dtype=torch.float64), dim=-1)
    w[..., 2] = w[..., 2].abs()
    by_directions = ShadingGeometry.of_directions(*w)
    by_angles = ShadingGeometry.of_angles(*half_difference(*w))
    for name in ("cos_i", "cos_o", "cos_h", "sin2_h", "cos_d"):
        torch.testing.assert_close(getattr(by_directions, name), getattr(by_angles, name), msg=name)
    assert by_directions.above.all()
    torch.testing.assert_close(by_directions.cos_i[:, 0], w[0, :, 2])
    torch.testing.assert_close(by_directions.cos_o[:, 0], w[1, :, 2])


def test_another_precision():
    one = of_half_angle(0.3).to(torch.float32)
    assert one.cos_h.dtype == torch.float32
    assert one.above.dtype == torch.bool
    assert one.cos_h.shape == (1, 1)
