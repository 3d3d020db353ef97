"""Masks of balls and what is easily taken for one."""

import torch


def disc(height: int, width: int, x: float, y: float, radius: float) -> torch.Tensor:
    """(1, height, width) bool: pixels whose centres lie inside a circle."""
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    return ((columns - x) ** 2 + (rows - y) ** 2 <= radius**2)[None]
