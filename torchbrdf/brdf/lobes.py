"""An analytic BRDF of a few heavy-tailed lobes, and the parameters of the embedded default library.

    f_r = sum over lobes of  k D(theta_h, theta_d) F(theta_d) G(cos theta_i, cos theta_o)
    D = (1 + (x / b)^q)^-c,   x = 1 - cos theta_h,   b = B exp(s u + t u^2),   u = 1 - cos theta_d
    F = (1 + (R - 1) u^p) exp(r u)
    G = ((cos theta_i + a) (cos theta_o + a))^-g

D is the ABC distribution [LKYU12] with a free inner exponent q and a width b that may change towards grazing
angles. F is Schlick's Fresnel factor [Sch94] relative to normal incidence, with a free exponent p, a free
grazing value R, and a slope r. G is our empirical stand-in for shadowing over 4 cos theta_i cos theta_o,
finite at the horizon (Cook-Torrance without shadowing is g = 1, a = 0). A lobe with small c or with B of
order 1 is a diffuse term. Every lobe is reciprocal and positive; only the parameters keep the albedo below 1.
"""

import json
from collections.abc import Mapping
from importlib.resources import as_file, files
from math import cos, sin

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf.merl import GRID, cell_centres

MODEL_VERSION = 1
"""Changes with the formula: tables expanded from the parameters of another version are stale."""

PARAMETER_NAMES = (
    "strength",  # k > 0, 1/sr
    "width",  # B > 0: where D leaves its plateau, in 1 - cos theta_h
    "bend",  # q > 0: how sharply it leaves it
    "decay",  # c > 0: the tail falls as x^(-q c)
    "widening",  # s
    "widening_quadratic",  # t
    "grazing",  # R > 0: F at theta_d = 90 degrees relative to 0, the slope aside
    "exponent",  # p > 0: 5 in Schlick's approximation
    "slope",  # r
    "masking",  # g: positive brightens towards the horizon
    "softness",  # a > 0: keeps G finite at the horizon
)
"""The parameters of one lobe; each is a tensor (n, lobes)."""

Parameters = Mapping[str, Tensor]

_DEFAULT_FILE = "default_library.safetensors"
_X_MIN = 1e-30  # keeps log(x) finite on the axis
_BLOCK_ROWS = 6  # theta_d rows expanded at once, a divisor of 90; so few that they stay in the cache


def evaluate_lobes(parameters: Parameters, theta_h: Tensor, theta_d: Tensor, phi_d: Tensor) -> Tensor:
    """f_r of n BRDFs at half/difference angles.

    f_r = sum k D F G, see the head of this module.
    parameters               each name of PARAMETER_NAMES -> (n, lobes)
    theta_h, theta_d, phi_d  (...), broadcast against each other, radians
    returns                  (..., n) 1/sr, in the precision of the parameters; finite but meaningless below
                             the horizon
    raises                   ValueError where a parameter is missing or of another shape
    """
    check_parameters(parameters)
    dtype = parameters["strength"].dtype
    theta_h, theta_d, phi_d = (angle[..., None].double() for angle in (theta_h, theta_d, phi_d))
    log_x, u = _log_x(theta_h).to(dtype), (2 * torch.sin(theta_d / 2) ** 2).to(dtype)
    base, swing = (
        torch.cos(theta_d) * torch.cos(theta_h),
        torch.sin(theta_d) * torch.sin(theta_h) * torch.cos(phi_d),
    )
    cos_i, cos_o = (base - swing).clamp_min(0).to(dtype), (base + swing).clamp_min(0).to(dtype)
    total: Tensor | float = 0.0
    for lobe in _lobes(parameters):
        a = lobe["softness"]
        log_g = -lobe["masking"] * (torch.log(cos_i + a) + torch.log(cos_o + a))
        total = total + torch.exp(_log_separable(lobe, log_x, u) + log_g)
    return torch.as_tensor(total)


def expand_row(parameters: Parameters, theta_h: float) -> Tensor:
    """f_r of n BRDFs at the cells of one theta_h row of the MERL grid; 90 rows of 300 BRDFs take seconds.

    parameters  each name of PARAMETER_NAMES -> (n, lobes)
    theta_h     radians
    returns     (90 * 180, n) float32 1/sr, theta_d slow and phi_d fast as in a MERL file; finite but
                meaningless below the horizon

    G sees phi_d only through (cos theta_i + a)(cos theta_o + a) = P + 2 a m + a^2, with P = cos theta_i
    cos theta_o and m = (cos theta_i + cos theta_o) / 2 = cos theta_h cos theta_d, and reciprocity makes
    f_r(pi - phi_d) = f_r(phi_d): a row costs one logarithm and one exponential a lobe and two cells.
    """
    check_parameters(parameters)
    half = GRID[2] // 2
    theta_d, phi_d = cell_centres()[1], cell_centres()[2][:half]
    mean = cos(theta_h) * torch.cos(theta_d)
    swing = sin(theta_h) * torch.sin(theta_d) * torch.cos(phi_d)
    product = (mean**2 - swing**2).clamp_min(0)[..., None].float().numpy()
    u, log_x = 2 * torch.sin(theta_d / 2) ** 2, _log_x(torch.tensor(theta_h, dtype=torch.float64))
    coefficients = []
    for lobe in _lobes({name: value.detach().cpu().double() for name, value in parameters.items()}):
        a = lobe["softness"]
        terms = (2 * a * mean + a**2, -lobe["masking"].expand(len(u), -1), _log_separable(lobe, log_x, u))
        coefficients.append([term[:, None].float().numpy() for term in terms])
    row = np.zeros((*GRID[1:], len(parameters["strength"])), dtype=np.float32)

    # NumPy, serial: seconds. The same in torch on busy cores takes minutes, at the barriers of its threads.
    buffer = np.empty_like(row[:_BLOCK_ROWS, :half])
    for start in range(0, GRID[1], _BLOCK_ROWS):
        rows = slice(start, start + _BLOCK_ROWS)
        for offset, power, log_df in coefficients:
            np.log(np.add(product[rows], offset[rows], out=buffer), out=buffer)
            np.multiply(buffer, power[rows], out=buffer)
            np.add(buffer, log_df[rows], out=buffer)
            row[rows, :half] += np.exp(buffer, out=buffer)
    row[:, half:] = row[:, half - 1 :: -1]
    return torch.from_numpy(row).flatten(0, 1)


def load_default_parameters() -> tuple[tuple[str, ...], dict[str, Tensor]]:
    """The embedded library: material names, and parameters (n, lobes) of n = 3 columns (R, G, B) a material.

    `scripts/fit_default_library.py` computes the file and docs/default_library.md says how well it fits.
    """
    from safetensors import safe_open

    with as_file(files("torchbrdf.brdf") / _DEFAULT_FILE) as path, safe_open(path, framework="pt") as file:
        names = tuple(json.loads(file.metadata()["names"]))
        return names, {name: file.get_tensor(name) for name in PARAMETER_NAMES}


def check_parameters(parameters: Parameters) -> None:
    """Raise ValueError unless every parameter is there and all have one shape (n, lobes)."""
    missing = [name for name in PARAMETER_NAMES if name not in parameters]
    if missing:
        raise ValueError(f"lobe parameters lack {', '.join(missing)}; each of PARAMETER_NAMES is needed")
    shape = parameters["strength"].shape
    if len(shape) != 2:
        raise ValueError(f"lobe parameters must be (n, lobes), got strength {tuple(shape)}")
    for name in PARAMETER_NAMES:
        if parameters[name].shape != shape:
            raise ValueError(
                f"lobe parameters must share one shape, got {name} {tuple(parameters[name].shape)} "
                f"beside strength {tuple(shape)}"
            )


def _lobes(parameters: Parameters) -> list[dict[str, Tensor]]:
    count = parameters["strength"].shape[1]
    return [{name: parameters[name][:, i] for name in PARAMETER_NAMES} for i in range(count)]


def _log_x(theta_h: Tensor) -> Tensor:
    return torch.log((2 * torch.sin(theta_h / 2) ** 2).clamp_min(_X_MIN))


def _log_separable(lobe: Mapping[str, Tensor], log_x: Tensor, u: Tensor) -> Tensor:
    """log(k D F): what does not depend on phi_d."""
    log_b = torch.log(lobe["width"]) + u * (lobe["widening"] + u * lobe["widening_quadratic"])
    log_d = -lobe["decay"] * torch.nn.functional.softplus(lobe["bend"] * (log_x - log_b), threshold=40.0)
    log_f = torch.log1p((lobe["grazing"] - 1) * u ** lobe["exponent"]) + lobe["slope"] * u
    return torch.log(lobe["strength"]) + log_d + log_f
