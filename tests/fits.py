"""Analytic fits of known parameters."""

import torch

from torchbrdf.analytic.table_fit import AnalyticFit

NAME = "brass & <rough> 2"


def fitted(model: str, name: str = NAME, **parameters: float | list[float]) -> AnalyticFit:
    """A result of these parameters."""
    tensors = {
        key: torch.tensor(value if isinstance(value, list) else [value], dtype=torch.float64)
        for key, value in parameters.items()
    }
    return AnalyticFit(model, tensors, "l2", 0.125, True, 3, 9, 0.5, name=name)


BRASS = fitted("metallic-roughness", base_color=[0.9, 0.6, 0.2], metallic=0.75, roughness=0.3)
