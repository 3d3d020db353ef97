"""Half/difference angles to and from direction pairs.

The half vector h bisects w_i and w_o; the difference vector is w_i turned into the frame of h
[Rus98]. Directions are unit vectors in the local frame of the surface (normal +Z); angles are in
radians: theta_h, theta_d in [0, pi/2], phi_d in (-pi, pi]. An isotropic BRDF does not depend on phi_h.
"""

import torch
from torch import Tensor

from torchbrdf.arguments import check_last


def half_difference(w_i: Tensor, w_o: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """theta_h, theta_d, phi_d of direction pairs.

    w_i, w_o  (..., 3)  unit vectors in the local frame (normal +Z)
    returns   three tensors (...)

    Arcs of small angles come from atan2 of a sine and a cosine: acos(n.h) in float32 is one MERL cell
    wrong near theta_h = 0. Raises ValueError where the last axis is no x, y, z. Source: [Rus98, sec. 3], [MPBM03].
    """
    check_last(w_i, 3, "w_i")
    check_last(w_o, 3, "w_o")
    both = w_i + w_o
    length = _length(both)
    h = both / length.clamp_min(1e-20)[..., None]
    sin_h = torch.hypot(h[..., 0], h[..., 1])
    theta_h = torch.atan2(sin_h, h[..., 2])
    theta_d = torch.atan2(_length(w_i - w_o), length)
    return theta_h, theta_d, difference_azimuth(w_i, w_o, h, sin_h)


def _length(v: Tensor) -> Tensor:
    """(...) of vectors (..., 3): where x, y and z lie apart in memory, `vector_norm` takes sixty times as long."""
    return torch.hypot(torch.hypot(v[..., 0], v[..., 1]), v[..., 2])


def difference_azimuth(w_i: Tensor, w_o: Tensor, h: Tensor, sin_h: Tensor) -> Tensor:
    """phi_d: the azimuth of w_i about h, zero in the plane of the normal and h, on the side away from the normal.

    With t = (h cos theta_h - n) / sin theta_h and b = n x h / sin theta_h, phi_d = atan2(w_i.b, w_i.t). The
    half-difference (w_i - w_o)/2 stands for w_i: it has no component along h, so nothing cancels.
    """
    d = w_i - w_o
    d_t = (d * h).sum(-1) * h[..., 2] - d[..., 2]
    d_b = h[..., 0] * d[..., 1] - h[..., 1] * d[..., 0]
    on_axis = sin_h == 0  # phi_h is undefined: MERL's convention is phi_h = 0, so t = +X and b = +Y
    return torch.where(on_axis, torch.atan2(d[..., 1], d[..., 0]), torch.atan2(d_b, d_t))


def from_half_difference(theta_h: Tensor, theta_d: Tensor, phi_d: Tensor) -> tuple[Tensor, Tensor]:
    """The direction pair (w_i, w_o), each (..., 3), of half/difference angles, with phi_h = 0 [Rus98].

    Either direction may come out below the horizon (negative z): not every triple is a reflection.
    """
    sin_h, cos_h = torch.sin(theta_h), torch.cos(theta_h)
    sin_d, cos_d = torch.sin(theta_d), torch.cos(theta_d)
    d_t, d_b = sin_d * torch.cos(phi_d), sin_d * torch.sin(phi_d)

    def to_surface(t: Tensor, b: Tensor) -> Tensor:
        x, z = t * cos_h + cos_d * sin_h, cos_d * cos_h - t * sin_h
        return torch.stack([x, b.expand_as(x), z], dim=-1)

    return to_surface(d_t, d_b), to_surface(-d_t, -d_b)
