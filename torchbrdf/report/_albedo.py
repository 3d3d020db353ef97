"""How much of the light a BRDF reflects."""

from functools import lru_cache
from math import radians

import torch
from torch import Tensor

from torchbrdf.brdf import MerlTable
from torchbrdf.estimation import albedo_rule

ALBEDO_DEG = (0, 30, 60, 75)

MUCH_ALBEDO = 1.02
"""Directional albedo above which a page says so: the rule of cells is good to a per cent."""


def directional_albedo(table: MerlTable) -> Tensor:
    """(4,) float64: the share of light from `ALBEDO_DEG` that is reflected, mean of R, G, B."""
    f_r = table.filled.cpu().double()
    return torch.stack([(weights @ f_r[cells]).mean() for cells, weights in _rules()])


@lru_cache(maxsize=1)
def _rules() -> list[tuple[Tensor, Tensor]]:
    return [albedo_rule(radians(angle)) for angle in ALBEDO_DEG]


def reflects_too_much(albedo: Tensor) -> str | None:
    """What to say of a directional albedo (4,) above 1; None where it is none."""
    if not albedo.max() > MUCH_ALBEDO:
        return None
    return f"reflects {float(albedo.max()):.2f} times the light that comes in at {ALBEDO_DEG[int(albedo.argmax())]}°"
