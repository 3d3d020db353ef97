"""The analytic BRDFs by name, with their parameters and the bounds within which they are fitted."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf import microfacet
from torchbrdf.shading_geometry import ShadingGeometry

Parameters = Mapping[str, Tensor]
"""Name -> (*batch, 1) of a number, or (*batch, 3) of one number a colour channel."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a model.

    lower, upper  bounds, both allowed
    default       where a fit that knows nothing starts
    colour        one value a channel; others are shared by the channels unless a fit is told otherwise
    logarithmic   fitted as its logarithm
    starts        values from which fits with several starts begin; empty: the default only
    """

    name: str
    lower: float
    upper: float
    default: float
    colour: bool = False
    logarithmic: bool = False
    starts: tuple[float, ...] = ()


@dataclass(frozen=True)
class AnalyticModel:
    """A BRDF with parameters.

    f_r               of a geometry and the parameters by name, see `microfacet`
    source            key in docs/references.bib
    channels_coupled  a channel of f_r depends on other channels of a colour
    reciprocal        f_r(w_i, w_o) = f_r(w_o, w_i)
    energy_conserving no more is reflected than comes in, for any parameters within the bounds
    """

    name: str
    f_r: Callable[..., Tensor]
    parameters: tuple[Parameter, ...]
    source: str
    channels_coupled: bool = False
    reciprocal: bool = True
    energy_conserving: bool = False

    @property
    def defaults(self) -> dict[str, Tensor]:
        """The usual start: each parameter's default, (1,) or (3,) float64."""
        return {
            p.name: torch.full((3 if p.colour else 1,), p.default, dtype=torch.float64) for p in self.parameters
        }

    def evaluate(self, parameters: Parameters, geometry: ShadingGeometry) -> Tensor:
        """f_r (*batch, N, 3) in 1/sr of N pairs of directions, 0 where one lies below the horizon.

        parameters  name -> (*batch, 1) or (*batch, 3)
        geometry    of N pairs
        Raises ValueError where a parameter is missing, unknown or of another shape.
        """
        self.check(parameters)
        values = self.f_r(geometry, **{name: value[..., None, :] for name, value in parameters.items()})
        return torch.where(geometry.above, values, 0).expand(*values.shape[:-1], 3)

    def check(self, parameters: Parameters) -> None:
        """Raise ValueError unless the parameters are those of the model, each (*batch, 1) or (*batch, 3)."""
        expected = [p.name for p in self.parameters]
        if set(parameters) != set(expected):
            raise ValueError(f"{self.name} needs the parameters {', '.join(expected)}, got {', '.join(parameters)}")
        for name, value in parameters.items():
            if value.ndim == 0 or value.shape[-1] not in (1, 3):
                raise ValueError(
                    f"parameter {name} of {self.name} must be (*batch, 1) or (*batch, 3), got {tuple(value.shape)}"
                )


_ROUGHNESS_STARTS = (0.03, 0.1, 0.25, 0.5)

DIFFUSE = Parameter("diffuse", 0.0, 1.0, 0.5, colour=True)
F0 = Parameter("specular", 0.0, 1.0, 0.04, colour=True)
ALPHA = Parameter("roughness", 1e-3, 1.0, 0.3, logarithmic=True, starts=_ROUGHNESS_STARTS)

MODELS: dict[str, AnalyticModel] = {
    model.name: model
    for model in (
        AnalyticModel("lambert", microfacet.lambert, (DIFFUSE,), "Lam60", energy_conserving=True),
        AnalyticModel("ggx", microfacet.ggx, (DIFFUSE, F0, ALPHA), "WMLT07"),
    )
}


def model_of(name: str) -> AnalyticModel:
    """A model by its name. Raises ValueError with the names there are."""
    if name not in MODELS:
        raise ValueError(f"no analytic model {name!r}; there are {', '.join(MODELS)}")
    return MODELS[name]
