"""Fresnel factors: the share of unpolarised light that a smooth boundary reflects, seen from air."""

from torch import Tensor

_TINY = 1e-12
"""Least value under a square root: keeps its derivative finite."""


def schlick_weight(cosine: Tensor) -> Tensor:
    """(1 - cos theta)^5, by which Schlick goes from normal incidence to grazing [Sch94]."""
    rest = 1 - cosine
    return rest.square().square() * rest


def schlick(cos_d: Tensor, f0: Tensor) -> Tensor:
    """F = F0 + (1 - F0) (1 - cos theta_d)^5, from F0 at normal incidence to 1 at grazing [Sch94]."""
    return f0 + (1 - f0) * schlick_weight(cos_d)


def normal_incidence(eta: Tensor) -> Tensor:
    """F0 = ((eta - 1) / (eta + 1))^2 of a dielectric of relative index eta."""
    return ((eta - 1) / (eta + 1)).square()


def dielectric(cos_d: Tensor, eta: Tensor) -> Tensor:
    """F of a boundary between dielectrics; with c = cos theta_d and g^2 = eta^2 - 1 + c^2

    F = (g - c)^2 / (2 (g + c)^2) (1 + (c (g + c) - 1)^2 / (c (g - c) + 1)^2)

    eta  index of refraction of the inside over that of the outside, at least 1

    g - c is (eta^2 - 1) / (g + c): near eta = 1 the difference would have few digits left. Source: [CT82].
    """
    excess = (eta - 1) * (eta + 1)
    g = (excess + cos_d.square()).clamp_min(_TINY).sqrt()
    over = g + cos_d
    under = excess / over
    ratio = (cos_d * over - 1) / (cos_d * under + 1)
    return (under / over).square() * (1 + ratio.square()) / 2


def conductor(cos_d: Tensor, eta: Tensor, k: Tensor) -> Tensor:
    """F of a boundary to a metal of index eta - i k.

    With s = sin^2 theta_d, t = eta^2 - k^2 - s, q = sqrt(t^2 + 4 eta^2 k^2) and a = sqrt((q + t) / 2)

    R_s = (q + c^2 - 2 a c) / (q + c^2 + 2 a c),  R_p = R_s (q c^2 + s^2 - 2 a c s) / (q c^2 + s^2 + 2 a c s),

    F = (R_s + R_p) / 2.

    eta, k  index of refraction and extinction coefficient over the index of the outside, positive

    Source: [BW99, sec. 14.2], in real numbers.
    """
    cos2 = cos_d.square()
    sin2 = 1 - cos2
    eta2, k2 = eta.square(), k.square()
    t = eta2 - k2 - sin2
    q = (t.square() + 4 * eta2 * k2).clamp_min(_TINY**2).sqrt()
    a = ((q + t) / 2).clamp_min(_TINY).sqrt()
    s_sum, s_cross = q + cos2, 2 * a * cos_d
    p_sum, p_cross = q * cos2 + sin2.square(), s_cross * sin2
    r_s = (s_sum - s_cross) / (s_sum + s_cross)
    return r_s * (1 + (p_sum - p_cross) / (p_sum + p_cross)) / 2
