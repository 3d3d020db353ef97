"""BRDFs as a Tucker decomposition of their logarithms [Tuc66], and that of the embedded library.

    log(1 + f_r / f_0) = sum over terms of  g  u_a(theta_h) v_b(theta_d) w_c(phi_d),   f_0 = 0.001 / sr

The profiles u, v and w are shared by all BRDFs: the leading eigenvectors of the scatter of their logarithms along each
angle, on the cells of MERL's grid. A BRDF is its coefficients g of the terms (a, b, c) that hold most of all BRDFs.
"""

import json
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib.resources import as_file, files

import torch
from torch import Tensor

from torchbrdf.brdf.merl_grid import GRID

MODEL_VERSION = 3
"""Changes with the formula: tables expanded from the coefficients of another version are stale."""

FLOOR = 1e-3
"""f_0 in 1/sr: what is far below it counts by its difference, what is far above by its ratio."""

DEFAULT_FILE = "default_library.safetensors"


@dataclass(frozen=True, eq=False)
class TuckerFactors:
    """n BRDFs on MERL's grid.

    theta_h, theta_d, phi_d  (90, A), (90, B), (180, C)  float32, the profiles
    terms                    (K, 3)  int16, which profile of each angle
    quantised                (K, n)  int16, g / step
    step                     (K,)    float32
    """

    theta_h: Tensor
    theta_d: Tensor
    phi_d: Tensor
    terms: Tensor
    quantised: Tensor
    step: Tensor

    @property
    def tensors(self) -> dict[str, Tensor]:
        """All of it, by name, as in a file."""
        return {part.name: getattr(self, part.name) for part in fields(self)}

    @cached_property
    def _core(self) -> Tensor:
        """(A, B C n) float32: g of all terms, 0 where a term is not kept."""
        sizes = [profile.shape[1] for profile in (self.theta_h, self.theta_d, self.phi_d)]
        core = torch.zeros(*sizes, self.quantised.shape[1], dtype=torch.float32)
        core[self.terms.long().unbind(1)] = self.quantised * self.step[:, None]
        return core.flatten(1)

    def subset(self, columns: Tensor) -> "TuckerFactors":
        """Those of some BRDFs (k,), which may be given twice."""
        return replace(self, quantised=self.quantised[:, columns])

    def row(self, i: int) -> Tensor:
        """(90 * 180, n) float32: f_r in 1/sr in row i of theta_h; finite but meaningless below the horizon."""
        n = self.quantised.shape[1]
        slab = (self.theta_h[i] @ self._core).view(self.theta_d.shape[1], -1)
        rows = (self.theta_d @ slab).view(GRID[1], -1, n)
        return (self.phi_d @ rows).expm1_().mul_(FLOOR).clamp_min_(0).flatten(0, 1)


def logarithm(f_r: Tensor) -> Tensor:
    """log(1 + f_r / f_0), what is decomposed."""
    return torch.log1p(f_r / FLOOR)


def load_default_factors() -> tuple[tuple[str, ...], TuckerFactors]:
    """The embedded library: material names, and factors of n = 3 columns (R, G, B) a material.

    `scripts/encode_default_library.py` computes the file and docs/default_library.md says how close it is.
    """
    from safetensors import safe_open

    with as_file(files("torchbrdf.brdf") / DEFAULT_FILE) as path, safe_open(path, framework="pt") as file:
        names = tuple(json.loads(file.metadata()["names"]))
        return names, TuckerFactors(**{part.name: file.get_tensor(part.name) for part in fields(TuckerFactors)})
