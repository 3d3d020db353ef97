"""A table as a `.bsdf` file in the format of the RGL database [DJ18], for `measured` of Mitsuba 3 and of pbrt-v4.

The microfacet model that a file brings along is the plainest there is, one density of half vectors for all directions
of incidence and a projected area that cancels: what the table holds is in the colours alone. The density makes cells of
small theta_h wide, where lobes are sharp; directions are sampled by the luminance, which holds what is reflected.

Mitsuba's RGB variants refuse files with wavelengths, and its spectral ones and pbrt-v4 those without: a file is for
either.
"""

from collections.abc import Callable
from math import pi
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf._tensor_file import write_tensor_file
from torchbrdf.brdf.merl_grid import GRID, grid_coordinates
from torchbrdf.brdf.spectra import SPECTRAL_NODES, basis_spectra
from torchbrdf.images import luminance

_THETA_I = 46
"""Every two degrees."""

_INTERVALS = ((6, 8), (16, 4), (GRID[0], 1))
"""Up to which row of theta_h there are how many intervals between nodes a row: edges of rows are nodes."""

_SHARP_ROWS = 16
"""Rows of theta_h that keep their edges; further out, f_r is linear between the middles of rows."""

_BEYOND = 0.1
"""How far below the horizon, in cos(theta_o), values go on so that those above are linear up to it."""

_EVERYWHERE = 0.02
"""Of the mean luminance, added to it: no direction is left out by sampling."""


def write_bsdf(
    path: Path,
    f_r: Callable[[Tensor, Tensor, Tensor], Tensor],
    valid: Tensor,
    name: str,
    spectral: bool,
) -> None:
    """Write a table.

    f_r       of coordinates in units of cells (n,), (n,), (n,) -> (n, 3), as `grid_coordinates` has them, any cell
    valid     (90, 90, 180) bool; the file marks the others as not measured, which only torchbrdf looks at
    spectral  spectra of these colours, which pbrt-v4 and Mitsuba's spectral variants read, in the place of RGB
    """
    rows, per_row = _nodes()
    nodes = len(rows)
    density = _density()
    theta_i = torch.linspace(0, pi / 2, _THETA_I, dtype=torch.float64)
    y, x = torch.meshgrid(
        torch.linspace(0, 1, nodes, dtype=torch.float64), torch.from_numpy(rows / GRID[0]), indexing="ij"
    )
    theta_m, azimuth = (x.square() * (pi / 2)).ravel(), ((2 * y - 1) * pi).ravel()
    sin_m, cos_m = theta_m.sin(), theta_m.cos()
    row = torch.from_numpy(np.tile(_looked_up(rows), nodes))
    spread = (2 * pi**2) * x.ravel() * sin_m / torch.from_numpy(np.tile(per_row * GRID[0] / (nodes - 1), nodes))
    colours = np.empty((_THETA_I, 3, nodes, nodes), np.float32)
    sampled = np.empty((_THETA_I, nodes, nodes), np.float32)
    measured = np.empty((_THETA_I, nodes, nodes), bool)
    for t, theta in enumerate(theta_i):
        # Of w_i: along m, along the tangent at m away from the normal, and along the one beside it.
        cos_d = theta.cos() * cos_m + theta.sin() * sin_m * azimuth.cos()
        along = theta.sin() * cos_m * azimuth.cos() - theta.cos() * sin_m
        aside = -theta.sin() * azimuth.sin()
        z_o = 2 * cos_d * cos_m - theta.cos()
        place = row, *grid_coordinates(theta_m, torch.arccos(cos_d.clamp(-1, 1)), torch.atan2(aside, along))[1:]
        seen = (cos_d > 0) & (z_o > -_BEYOND)
        values = torch.zeros(len(z_o), 3, dtype=torch.float64)
        values[seen] = f_r(*(coordinate[seen] for coordinate in place)).double().clamp_min(0) * z_o[seen, None]
        cells = tuple(c.long().clamp(0, n - 1) for c, n in zip(place, GRID, strict=True))
        colours[t] = values.T.reshape(3, nodes, nodes).numpy()
        reflected = luminance(values.T.clamp_min(0)) * spread * cos_d
        reflected = reflected + _EVERYWHERE * reflected.mean() + 1e-12
        sampled[t] = reflected.reshape(nodes, nodes).numpy()
        measured[t] = (valid[cells] & seen & (z_o > 0)).reshape(nodes, nodes).numpy()
    text = np.frombuffer(f"{name} (torchbrdf)".encode(), np.uint8)
    fields: dict[str, np.ndarray] = {
        "version": np.array([1, 0], np.uint32),
        "description": text,
        "phi_i": np.zeros(1, np.float32),
        "theta_i": theta_i.float().numpy(),
        "sigma": np.full((2, 2), 0.25, np.float32),
        "ndf": np.ones((2, 2), np.float32),
        "vndf": np.broadcast_to(density.astype(np.float32), (1, _THETA_I, 2, len(density))),
        "luminance": sampled[None],
        "jacobian": np.ones(1, np.uint8),
        "valid": np.packbits(measured),
    }
    if spectral:
        fields["wavelengths"] = SPECTRAL_NODES.astype(np.float32)
        fields["spectra"] = np.einsum("wc,tcyx->twyx", basis_spectra().astype(np.float32), colours)[None]
    else:
        fields["rgb"] = colours[None]
    write_tensor_file(path, fields)


def _nodes() -> tuple[np.ndarray, np.ndarray]:
    """(n,) nodes along theta_h in units of rows, and how many intervals a row there are where each lies."""
    starts = (0, *(end for end, _ in _INTERVALS[:-1]))
    parts = [np.arange(start, end, 1 / count) for start, (end, count) in zip(starts, _INTERVALS, strict=True)]
    counts = [np.full(len(part), float(count)) for part, (_, count) in zip(parts, _INTERVALS, strict=True)]
    return np.append(np.concatenate(parts), GRID[0]), np.append(np.concatenate(counts), _INTERVALS[-1][1])


def _density() -> np.ndarray:
    """(8 * 90 + 1,) of half vectors along the square root of theta_h, the same for all azimuths.

    It puts edges of rows where nodes are: before each place where it falls it is higher by half of that, once.
    """
    fine = _INTERVALS[0][1]
    row = np.arange(fine * GRID[0] + 1) / fine
    density = np.full(len(row), float(_INTERVALS[-1][1]))
    for end, count in reversed(_INTERVALS[:-1]):
        after = density[row == end]
        density[row < end] = count
        density[row == end - 1 / fine] += (count - after) / 2
    return density


def _looked_up(rows: np.ndarray) -> np.ndarray:
    """Where the table is looked up, linearly, for nodes along theta_h: where it is sharp, in the middle of a row.

    On an edge there, between the rows so that either keeps what it reflects: the solid angle of half vectors goes as
    the third power of the row's coordinate.
    """
    nodes, weights = np.polynomial.legendre.leggauss(3)
    share, weights = (nodes + 1) / 2, weights / 2
    places = np.floor(rows) + 0.5
    inner = rows[1:-1]
    before, after = np.diff(rows)[:-1], np.diff(rows)[1:]
    within = before * (((inner - before)[:, None] + before[:, None] * share) ** 3 @ (weights * share))
    beyond = after * ((inner[:, None] + after[:, None] * share) ** 3 @ (weights * (1 - share)))
    on_edge = inner == np.floor(inner)
    places[1:-1] += np.where(on_edge, beyond / (within + beyond) - 1, 0)
    return np.where(rows >= _SHARP_ROWS, rows, places)
