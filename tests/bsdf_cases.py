"""Pairs of directions, albedos, and what Mitsuba's BSDFs return: for tests of analytic models."""

from math import pi
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def direction_pairs(count: int, seed: int = 0, lowest: float = 0.02) -> tuple[Tensor, Tensor]:
    """w_i, w_o (count, 3) float64, above the horizon by a cosine of `lowest`: half near mirror pairs, half anywhere."""
    generator = torch.Generator().manual_seed(seed)
    z, swing = torch.rand(2, 2, count, generator=generator, dtype=torch.float64)
    z = lowest + (1 - lowest) * z
    near = torch.arange(count) < count // 2
    z[1] = torch.where(near, (z[0] + 0.1 * (z[1] - 0.5)).clamp(lowest, 1), z[1])
    phi = 2 * pi * swing
    phi[1] = torch.where(near, phi[0] + pi + 0.3 * (swing[1] - 0.5), phi[1])
    sine = torch.sqrt(1 - z**2)
    w_i, w_o = torch.stack([sine * torch.cos(phi), sine * torch.sin(phi), z], dim=-1)
    return w_i.float().double(), w_o.float().double()


def some_geometry(count: int = 60, seed: int = 0) -> ShadingGeometry:
    """Of `direction_pairs`."""
    return ShadingGeometry.of_directions(*direction_pairs(count, seed))


def numbers(**values: float | tuple[float, ...]) -> dict[str, Tensor]:
    """Parameters by name, (1,) or (3,) float64."""
    return {name: torch.tensor(value, dtype=torch.float64).reshape(-1) for name, value in values.items()}


def interior(name: str) -> dict[str, Tensor]:
    """Parameters of a model well within their bounds, colours of three different channels."""
    found = {}
    for p in MODELS[name].parameters:
        shares = torch.tensor([0.35, 0.55, 0.75] if p.colour else [0.45], dtype=torch.float64)
        ends = torch.tensor([p.lower, p.upper], dtype=torch.float64)
        if p.logarithmic:
            found[p.name] = torch.exp(torch.lerp(*ends.log(), shares))
        else:
            found[p.name] = torch.lerp(*ends, shares)
    return found


def around(cosine: float, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Directions over the sphere about the mirror of w_o, dense near it, w_o (n, 3), and solid angles (n,)."""
    nodes, weights = map(torch.from_numpy, np.polynomial.legendre.leggauss(count))
    share, weights = (nodes + 1) / 2, weights / 2
    angle, spread = pi * share**3, 3 * pi * share**2 * weights
    azimuth = (torch.arange(count, dtype=torch.float64) + 0.5) / count * 2 * pi
    sine = (1 - cosine**2) ** 0.5
    frame = torch.tensor([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], dtype=torch.float64)
    across = torch.stack([torch.cos(azimuth), torch.sin(azimuth)], dim=-1)
    flat = torch.sin(angle)[:, None, None] * across
    upright = torch.cos(angle)[:, None, None].expand(-1, count, 1)
    w_i = torch.cat([flat, upright], dim=-1).flatten(0, 1) @ frame
    solid = (spread * torch.sin(angle))[:, None].expand(-1, count).flatten() * (2 * pi / count)
    return w_i, torch.tensor([sine, 0, cosine], dtype=torch.float64).expand_as(w_i), solid


def albedo(name: str, parameters: dict[str, Tensor], cosine: float, count: int = 96) -> Tensor:
    """(3,): the share of the light from w_o that is reflected: by reciprocity, what white surroundings send there."""
    w_i, w_o, solid = around(cosine, count)
    above = w_i[:, 2] > 0
    f_r = MODELS[name].evaluate(parameters, ShadingGeometry.of_directions(w_i[above], w_o[above]))
    return (f_r * (w_i[above, 2] * solid[above])[:, None]).sum(0)


def rgb(*values: float) -> dict[str, Any]:
    """A colour as Mitsuba's dictionaries write it."""
    return {"type": "rgb", "value": list(values)}


def bsdf_f_r(mitsuba: ModuleType, description: dict[str, Any], w_i: Tensor, w_o: Tensor) -> Tensor:
    """f_r (N, 3) in 1/sr of a Mitsuba BSDF, which itself evaluates f_r cos(theta_o), in single precision."""
    bsdf = mitsuba.load_dict(description)
    interaction = mitsuba.SurfaceInteraction3f()
    interaction.wi = mitsuba.Vector3f(np.ascontiguousarray(w_i.numpy().T, dtype=np.float32))
    outgoing = mitsuba.Vector3f(np.ascontiguousarray(w_o.numpy().T, dtype=np.float32))
    values = np.array(bsdf.eval(mitsuba.BSDFContext(), interaction, outgoing)).T.astype(np.float64)
    return torch.from_numpy(values) / w_o[:, 2:]


def assert_agrees(
    mitsuba: ModuleType, description: dict[str, Any], name: str, parameters: dict[str, Tensor], rtol: float = 1e-4
) -> None:
    """The model and Mitsuba's BSDF return the same f_r for 2,000 pairs of directions."""
    w_i, w_o = direction_pairs(2000, seed=5)
    ours = MODELS[name].evaluate(parameters, ShadingGeometry.of_directions(w_i, w_o))
    torch.testing.assert_close(ours, bsdf_f_r(mitsuba, description, w_i, w_o), rtol=rtol, atol=1e-8)
