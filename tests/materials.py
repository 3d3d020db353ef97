"""Analytic materials of the tests."""

from math import pi

import torch
from torch import Tensor


def lambert(*albedo: float):
    """f_r of a Lambertian surface of these albedos."""
    colour = torch.tensor(albedo, dtype=torch.float64) / pi
    return lambda w_i, w_o: colour.expand(*w_i.shape[:-1], 3)


def glossy(albedo: tuple[float, ...], specular: tuple[float, ...], alpha: float):
    """Lambert plus a GGX-like lobe of roughness alpha, without shadowing."""
    base = torch.tensor(albedo, dtype=torch.float64) / pi
    top = torch.tensor(specular, dtype=torch.float64)

    def f_r(w_i: Tensor, w_o: Tensor) -> Tensor:
        cosine = torch.nn.functional.normalize(w_i + w_o, dim=-1)[..., 2:]
        lobe = alpha**2 / (pi * (cosine**2 * (alpha**2 - 1) + 1) ** 2)
        return base + top * lobe / (4 * (w_i[..., 2:] + w_o[..., 2:]).clamp_min(0.2))

    return f_r


TINY_MATERIALS = {
    "white": lambert(0.8, 0.8, 0.75),
    "red": lambert(0.6, 0.1, 0.05),
    "teal": lambert(0.05, 0.35, 0.4),
    "satin-0.5": glossy((0.3, 0.2, 0.1), (0.05, 0.05, 0.04), 0.5),
    "satin-0.35": glossy((0.1, 0.3, 0.15), (0.08, 0.08, 0.1), 0.35),
    "plastic-0.2": glossy((0.4, 0.05, 0.02), (0.05, 0.04, 0.05), 0.2),
    "plastic-0.1": glossy((0.02, 0.04, 0.3), (0.04, 0.05, 0.04), 0.1),
    "gold-0.3": glossy((0.01, 0.01, 0.005), (0.9, 0.7, 0.3), 0.3),
    "steel-0.15": glossy((0.005, 0.005, 0.006), (0.5, 0.55, 0.6), 0.15),
    "copper-0.08": glossy((0.0, 0.0, 0.0), (0.8, 0.4, 0.25), 0.08),
}


STRANGERS = {
    "paint": glossy((0.3, 0.08, 0.05), (0.06, 0.06, 0.06), 0.14),
    "brass": glossy((0.0, 0.0, 0.0), (0.7, 0.55, 0.25), 0.12),
    "satin": glossy((0.2, 0.25, 0.1), (0.2, 0.2, 0.2), 0.25),
    "clay": lambert(0.5, 0.4, 0.3),
}
"""Materials that no library of the tests holds."""
