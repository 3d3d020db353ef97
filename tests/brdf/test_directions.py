from math import cos, pi, sin

import pytest
import torch
from hypothesis import assume, given, strategies as st
from torch import Tensor

from torchbrdf.brdf.directions import from_half_difference, half_difference

cosines = st.floats(0.01, 1.0)
azimuths = st.floats(-pi, pi)


def direction(cosine: float, azimuth: float) -> Tensor:
    sine = (1 - cosine * cosine) ** 0.5
    return torch.tensor([sine * cos(azimuth), sine * sin(azimuth), cosine], dtype=torch.float64)


def random_pairs(n: int, seed: int = 0, lowest: float = 0.02) -> tuple[Tensor, Tensor]:
    g = torch.Generator().manual_seed(seed)
    d = torch.nn.functional.normalize(torch.randn(2, 4 * n, 3, generator=g, dtype=torch.float64), dim=-1)
    d[..., 2].abs_()
    d = d[:, (d[..., 2] > lowest).all(0)][:, :n]
    return d[0], d[1]


@pytest.mark.parametrize("shape", [(3, 5), (4,)])
def test_vectors_that_are_no_x_y_z_are_refused(shape: tuple[int, ...]):
    up, odd = torch.tensor([0.0, 0.0, 1.0]), torch.ones(shape)
    with pytest.raises(ValueError, match=r"^w_i must be \(\.\.\., 3\), got "):
        half_difference(odd, up)
    with pytest.raises(ValueError, match=r"^w_o must be \(\.\.\., 3\), got "):
        half_difference(up, odd)


def about_normal(d: Tensor, angle: float) -> Tensor:
    c, s = cos(angle), sin(angle)
    return torch.stack([c * d[..., 0] - s * d[..., 1], s * d[..., 0] + c * d[..., 1], d[..., 2]], dim=-1)


def by_rotations(w_i: Tensor, w_o: Tensor) -> tuple[float, float, float]:
    """Rusinkiewicz's own definition, one pair at a time: turn by -phi_h about n, then by -theta_h about the
    binormal, and read the angles of what has become of w_i.
    """
    h = (w_i + w_o) / torch.linalg.norm(w_i + w_o)
    theta_h = float(torch.acos(h[2].clamp(-1, 1)))
    phi_h = float(torch.atan2(h[1], h[0]))
    d = about_normal(w_i, -phi_h)
    c, s = cos(theta_h), sin(theta_h)
    d = torch.stack([c * d[0] - s * d[2], d[1], s * d[0] + c * d[2]])
    return theta_h, float(torch.acos(d[2].clamp(-1, 1))), float(torch.atan2(d[1], d[0]))


def test_angles_are_those_of_the_two_rotations_of_the_definition():
    w_i, w_o = random_pairs(200)
    theta_h, theta_d, phi_d = half_difference(w_i, w_o)
    for k in range(len(w_i)):
        expected = by_rotations(w_i[k], w_o[k])
        assert float(theta_h[k]) == pytest.approx(expected[0], abs=1e-7)
        assert float(theta_d[k]) == pytest.approx(expected[1], abs=1e-7)
        assert sin(float(phi_d[k]) - expected[2]) == pytest.approx(0, abs=1e-7)
        assert cos(float(phi_d[k]) - expected[2]) > 0


def test_mirror_configuration_by_hand():
    """w_i at 30 degrees towards +X, w_o at 30 degrees towards -X: h is the normal, theta_d is 30 degrees."""
    w_i = direction(cos(pi / 6), 0.0)
    w_o = direction(cos(pi / 6), pi)
    theta_h, theta_d, _ = half_difference(w_i, w_o)
    assert float(theta_h) == pytest.approx(0, abs=1e-15)
    assert float(theta_d) == pytest.approx(pi / 6, rel=1e-14)


def test_retroreflection_by_hand():
    """w_i = w_o: h is the direction itself, theta_d is 0."""
    w = direction(cos(0.7), 2.0)
    theta_h, theta_d, _ = half_difference(w, w)
    assert float(theta_h) == pytest.approx(0.7, rel=1e-14)
    assert float(theta_d) == 0


def test_in_plane_pair_has_phi_d_zero_on_the_far_side_of_h():
    """Both in the XZ plane, w_i tilted further than w_o: w_i is beyond h, phi_d = 0."""
    far, near = direction(cos(1.0), 0.0), direction(cos(0.2), 0.0)
    theta_h, theta_d, phi_d = half_difference(far, near)
    assert float(theta_h) == pytest.approx(0.6, rel=1e-13)
    assert float(theta_d) == pytest.approx(0.4, rel=1e-13)
    assert float(phi_d) == pytest.approx(0, abs=1e-13)
    assert abs(float(half_difference(near, far)[2])) == pytest.approx(pi, rel=1e-13)


@given(cosines, azimuths, cosines, azimuths)
def test_directions_to_angles_to_directions(cos_i: float, phi_i: float, cos_o: float, phi_o: float):
    """The pair comes back up to a turn about the normal: cosines and the angle between them are kept."""
    w_i, w_o = direction(cos_i, phi_i), direction(cos_o, phi_o)
    back_i, back_o = from_half_difference(*half_difference(w_i, w_o))
    h = w_i + w_o
    aside = float(torch.linalg.norm(h[:2]))
    assume(aside == 0 or aside > 1e-8)  # between, rounding turns the azimuth of h
    azimuth = float(torch.atan2(h[1], h[0]))
    assert torch.allclose(about_normal(back_i, azimuth), w_i, atol=1e-8)
    assert torch.allclose(about_normal(back_o, azimuth), w_o, atol=1e-8)
    assert torch.allclose(torch.linalg.norm(torch.stack([back_i, back_o]), dim=1), torch.ones(2).double())


@given(st.floats(1e-6, pi / 2 - 1e-6), st.floats(1e-6, pi / 2 - 1e-6), azimuths)
def test_angles_to_directions_to_angles(theta_h: float, theta_d: float, phi_d: float):
    angles = [torch.tensor(a, dtype=torch.float64) for a in (theta_h, theta_d, phi_d)]
    back = half_difference(*from_half_difference(*angles))
    assert float(back[0]) == pytest.approx(theta_h, abs=1e-9)
    assert float(back[1]) == pytest.approx(theta_d, abs=1e-9)
    # on the axes phi_d loses digits: what must agree is the displacement it stands for
    wrapped = (float(back[2]) - phi_d + pi) % (2 * pi) - pi
    assert abs(wrapped) * sin(theta_h) * sin(theta_d) < 1e-9


@given(cosines, azimuths, cosines, azimuths)
def test_reciprocity_is_half_a_turn_of_phi_d(cos_i: float, phi_i: float, cos_o: float, phi_o: float):
    w_i, w_o = direction(cos_i, phi_i), direction(cos_o, phi_o)
    there, back = half_difference(w_i, w_o), half_difference(w_o, w_i)
    assert float(there[0]) == pytest.approx(float(back[0]), abs=1e-14)
    assert float(there[1]) == pytest.approx(float(back[1]), abs=1e-14)
    turned = (float(there[2]) - float(back[2])) % (2 * pi)
    assert float(there[1]) < 1e-9 or turned == pytest.approx(pi, abs=1e-6)


@given(cosines, azimuths, cosines, azimuths, azimuths)
def test_turning_about_the_normal_changes_nothing(cos_i: float, phi_i: float, cos_o: float, phi_o: float, turn: float):
    pair = direction(cos_i, phi_i), direction(cos_o, phi_o)
    one, other = half_difference(*pair), half_difference(*(about_normal(w, turn) for w in pair))
    assert float(one[0]) == pytest.approx(float(other[0]), abs=1e-8)
    assert float(one[1]) == pytest.approx(float(other[1]), abs=1e-8)
    wrapped = (float(one[2] - other[2]) + pi) % (2 * pi) - pi
    assert abs(wrapped) * sin(float(one[0])) * sin(float(one[1])) < 1e-8


def test_ranges():
    theta_h, theta_d, phi_d = half_difference(*random_pairs(5000))
    assert 0 <= theta_h.min() <= theta_h.max() <= pi / 2
    assert 0 <= theta_d.min() <= theta_d.max() <= pi / 2
    assert -pi <= phi_d.min() < -3
    assert 3 < phi_d.max() <= pi


def test_small_theta_h_keeps_its_digits_in_float32():
    """acos(n.h) would give 0 or 3.5e-4 here: one MERL cell (0.2 mrad at the first) is lost."""
    expected = torch.logspace(-5, -2, 40, dtype=torch.float64)
    pair = from_half_difference(expected, torch.tensor(0.5).double(), torch.tensor(1.0).double())
    theta_h, theta_d, _ = half_difference(*(w.float() for w in pair))
    assert torch.allclose(theta_h.double(), expected, rtol=1e-4, atol=3e-7)
    assert torch.allclose(theta_d.double(), torch.tensor(0.5).double(), rtol=1e-6)


def test_small_theta_d_keeps_its_digits_in_float32():
    expected = torch.logspace(-5, -2, 40, dtype=torch.float64)
    pair = from_half_difference(torch.tensor(0.8).double(), expected, torch.tensor(1.0).double())
    theta_d = half_difference(*(w.float() for w in pair))[1]
    assert torch.allclose(theta_d.double(), expected, rtol=1e-4, atol=3e-7)


def test_shapes_broadcast():
    w_i, w_o = random_pairs(6)
    angles = half_difference(w_i[:, None], w_o[None])
    assert all(a.shape == (6, 6) for a in angles)
    assert torch.equal(torch.diagonal(angles[2]), half_difference(w_i, w_o)[2])
    pair = from_half_difference(torch.rand(4, 1, 1), torch.rand(5, 1), torch.rand(6))
    assert [w.shape for w in pair] == [(4, 5, 6, 3)] * 2
