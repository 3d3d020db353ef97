"""Half vectors at which the kernels of a zone are sampled, and where they mirror the view direction to."""

from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from torchbrdf.brdf import cell_index, half_difference, row_edges
from torchbrdf.transport.harmonic.grid import Zone


@dataclass(frozen=True)
class HalfVectors:
    """Half vectors for Q polar angles of normals x S of a zone, with where they reflect the view to.

    kernel   (Q, S)     cos(theta_i) times the zone's window
    weights  (Q, S)     the same times the measure of the light
    cells    (Q, S)     cells of the pair for delta > 0; that of its mirror image is the mirrored cell
    beta, delta  (Q, S)  of the light, delta in [0, pi]
    """

    kernel: Tensor
    weights: Tensor
    cells: Tensor
    beta: Tensor
    delta: Tensor


def half_vectors(zone: Zone, gamma: Tensor, tilt: Tensor, n: int) -> HalfVectors:
    """Half vectors of a zone for rings gamma (Q,), two in theta_h for each row of MERL's grid.

    tilt  (Q,)  of the view direction away from the normal
    n     on a half circle about the normal
    """
    edges = row_edges()
    edges = edges[: int((edges < zone.reach).sum()) + 1]
    middle, half = (edges[1:] + edges[:-1]) / 2, (edges[1:] - edges[:-1]) / 2
    theta_h = (middle[:, None] + half[:, None] * torch.tensor([-1.0, 1.0]) / 3**0.5).ravel()  # Gauss-Legendre
    phi_h = (torch.arange(n, dtype=torch.float64) + 0.5) * (pi / n)
    window, measure = zone.window(theta_h), half.repeat_interleave(2) * torch.sin(theta_h) * (pi / n)
    lit = window > 0
    theta_h, phi_h = torch.meshgrid(theta_h[lit], phi_h, indexing="ij")
    window, measure = (values[lit].repeat_interleave(n) for values in (window, measure))
    h = torch.stack([torch.sin(theta_h) * torch.cos(phi_h), torch.sin(theta_h) * torch.sin(phi_h), torch.cos(theta_h)])
    h = h.flatten(1)[:, None]  # in the frame of the normal, whose first axis points down from the view direction
    seen = (gamma + tilt / 2)[:, None]
    v = torch.stack([-torch.sin(seen), torch.zeros_like(seen), torch.cos(seen)])
    along = (h * v).sum(0)
    w = 2 * along * h - v
    kernel = w[2] * window * ((along > 0) & (w[2] > 0))
    weights = 4 * along * measure * kernel
    sine, cosine = torch.sin(gamma - tilt / 2)[:, None], torch.cos(gamma - tilt / 2)[:, None]
    x, z = w[0] * cosine + w[2] * sine, w[2] * cosine - w[0] * sine
    beta, delta = torch.atan2(torch.hypot(x, w[1]), z), torch.atan2(w[1], x).abs()
    local_i, local_o = torch.broadcast_tensors(w.movedim(0, -1), v.movedim(0, -1))
    angles = half_difference(local_i, local_o)
    theta_h = theta_h.ravel().expand_as(angles[0])
    return HalfVectors(kernel, weights, cell_index(theta_h, *angles[1:]), beta, delta)
