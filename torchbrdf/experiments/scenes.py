"""What is measured on: scenes (a probe or a directional light), noise, cells of the BRDF."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.brdf import (
    MaterialLibrary,
    above_horizon,
    cell_centres,
    cell_index,
    from_half_difference,
    half_difference,
)
from torchbrdf.view import View

COMPARED_CELLS = 4096
"""BRDFs are compared over this many random cells."""

MIN_COSINE = 0.05
"""How far above the horizon, in cosine, both directions of a compared cell lie at least."""


@dataclass(frozen=True)
class Images:
    """Images y in the coordinates of a scene: what Q spans of them, the energy outside, and all of |y|^2.

    coordinates (*batch, 3, r), outside (*batch, 3), energy (*batch, 3)
    """

    coordinates: Tensor
    outside: Tensor
    energy: Tensor


@dataclass(frozen=True)
class Scene:
    """Basis images Y = Q R of all n columns, one factorisation a channel for all materials and methods.

    |Y w - y|^2 = |R w - Q^T y|^2 + |y - Q Q^T y|^2 for any w, so norms over P pixels become norms over r <= 300
    numbers, and least squares on columns of R loses nothing (a Gram matrix would square the condition number).

    q  (3, P, r), r  (3, r, n)
    """

    name: str
    q: Tensor
    r: Tensor

    @classmethod
    def of(cls, name: str, packed: Tensor) -> "Scene":
        """Factor basis images (n, 3, P)."""
        return cls(name, *torch.linalg.qr(packed.double().permute(1, 2, 0)))

    def project(self, y: Tensor) -> Images:
        """Images (*batch, 3, P), float64."""
        coordinates = torch.einsum("cpr,...cp->...cr", self.q, y)
        inside = torch.einsum("cpr,...cr->...cp", self.q, coordinates)
        return Images(coordinates, (y - inside).square().sum(-1), y.square().sum(-1))

    def error(self, weights: Tensor, target: Images) -> Tensor:
        """|Y w - y| / |y| over pixels and channels: weights (*batch, 3, n), target broadcasting to it."""
        fitted = torch.einsum("crn,...cn->...cr", self.r, weights)
        squared = ((fitted - target.coordinates).square().sum(-1) + target.outside).sum(-1)
        return torch.sqrt(squared / target.energy.sum(-1))


def noisy_observations(image: Tensor, levels: Sequence[float], key: str) -> Tensor:
    """(s, 3, ...): an image (3, ...) times 1 + level/100 e, the same e for every level, from the hash of `key`."""
    seed = int.from_bytes(hashlib.sha256(key.encode()).digest()[:7], "little")
    e = torch.randn(image.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.stack([image * (1 + level / 100 * e) for level in levels])


def directional_scene(library: MaterialLibrary, view: View, angle: float) -> tuple[Scene, Tensor]:
    """The view at pixel centres under light of unit irradiance, turned by `angle` degrees about +Y from the camera.

    returns  the scene, and its basis images (n, 3, P): f_r cos(theta_i)
    """
    light = torch.tensor([sin(radians(angle)), 0, cos(radians(angle))], dtype=torch.float64)
    normals, w_o = (view.pack(image).T.double() for image in (view.normals, view.view_dirs))
    cos_i = normals @ light
    lit = cos_i > 0
    normals, w_o, cos_i = normals[lit], w_o[lit], cos_i[lit]
    across = torch.tensor([0.6, 0.8, 0], dtype=torch.float64) + 0 * normals
    t = normalize(torch.linalg.cross(normals, across), dim=-1)
    frame = torch.stack([t, torch.linalg.cross(normals, t), normals], dim=1)
    angles = half_difference(frame @ light, torch.einsum("pij,pj->pi", frame, w_o))
    packed = (library.rows(cell_index(*angles)).double() * cos_i[:, None]).T[:, None].expand(-1, 3, -1)
    return Scene.of(f"light {angle}", packed), packed


@dataclass(frozen=True)
class CellSample:
    """Random cells of the BRDF: columns (C, n) and cos(theta_i) (C,)."""

    columns: Tensor
    cos_i: Tensor

    @classmethod
    def of(cls, library: MaterialLibrary, seed: int) -> "CellSample":
        """Cells drawn uniformly among those with both directions MIN_COSINE above the horizon."""
        w_i, w_o = from_half_difference(*cell_centres())
        high = above_horizon() & (w_i[..., 2] >= MIN_COSINE) & (w_o[..., 2] >= MIN_COSINE)
        inside = torch.nonzero(high.ravel()).ravel()
        drawn = torch.randint(len(inside), (COMPARED_CELLS,), generator=torch.Generator().manual_seed(seed))
        cells = inside[drawn]
        return cls(library.rows(cells).double(), w_i[..., 2].ravel()[cells])

    def compare(self, weights: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
        """Of BRDFs with weights (*batch, 3, n) against the columns `truth` (3,), over cells and channels.

        returns  mean |log(1 + f cos) - log(1 + g cos)| (negative f count as 0), and the sum of negative f over
                 the sum of |f|
        """
        f = torch.einsum("pn,...cn->...pc", self.columns, weights)
        g = self.columns[:, truth]
        difference = torch.log1p(f.clamp_min(0) * self.cos_i[:, None]) - torch.log1p(g * self.cos_i[:, None])
        negative = (-f).clamp_min(0).sum((-2, -1)) / f.abs().sum((-2, -1)).clamp_min(1e-300)
        return difference.abs().mean((-2, -1)), negative
