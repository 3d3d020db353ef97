"""What no photograph shows, from around it: the smoothest continuation over the sphere."""

import numpy as np
import torch
from torch import Tensor

from torchbrdf.light.mirror.unwrapping import Seen


def filled(seen: Seen) -> Tensor:
    """(3, H, 2 H): the radiance, harmonic where nothing was seen: each texel there is the mean of those around it."""
    from scipy.sparse import coo_matrix  # here, because it is slow to import
    from scipy.sparse.linalg import splu

    unknown = ~seen.known.cpu().numpy()
    height, width = unknown.shape
    if not unknown.any():
        return seen.radiance
    step = np.pi / (height - 1)
    sine = np.sin(np.arange(height) * step).clip(np.sin(step / 4))
    between = np.sin((np.arange(height - 1) + 0.5) * step)
    number = np.cumsum(unknown).reshape(unknown.shape) - 1
    row, column = np.nonzero(unknown)
    values = seen.radiance.cpu().double().numpy()
    goal = np.zeros((len(row), 3))
    diagonal = np.zeros(len(row))
    entries: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        other_row, other_column = row + down, (column + right) % width
        there = (other_row >= 0) & (other_row < height)
        other_row = other_row.clip(0, height - 1)
        weight = 1 / sine[row] if right else between[np.minimum(row, other_row).clip(0, height - 2)]
        weight = np.where(there, weight, 0.0)
        diagonal += weight
        free = there & unknown[other_row, other_column]
        here = number[row, column]
        entries.append((here[free], number[other_row, other_column][free], -weight[free]))
        fixed = there & ~free
        goal[fixed] += weight[fixed, None] * values[:, other_row[fixed], other_column[fixed]].T
    entries.append((np.arange(len(row)), np.arange(len(row)), diagonal))
    i, j, v = (np.concatenate(part) for part in zip(*entries, strict=True))
    solution = splu(coo_matrix((v, (i, j)), shape=(len(row), len(row))).tocsc()).solve(goal)
    values[:, row, column] = solution.T
    return torch.from_numpy(values).to(seen.radiance)
