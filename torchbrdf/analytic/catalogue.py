"""The analytic BRDFs by name."""

from importlib import import_module

from torchbrdf.analytic import models
from torchbrdf.analytic.model import AnalyticModel
from torchbrdf.files import did_you_mean

MODELS: dict[str, AnalyticModel] = {
    name: import_module(f"{models.__name__}.{name.replace('-', '_')}").MODEL for name in models.NAMES
}
"""Every model of the folder `models`."""


def model_of(name: str) -> AnalyticModel:
    """A model by its name. Raises ValueError with the names there are."""
    if not isinstance(name, str):
        raise ValueError(f"an analytic model is given by its name, such as 'ggx', got {type(name).__name__}")
    if name not in MODELS:
        raise ValueError(f"no analytic model {name!r}{did_you_mean(name, MODELS)}; there are {', '.join(MODELS)}")
    return MODELS[name]
