"""What an analytic BRDF is: a function with parameters, and the bounds within which they are fitted.

Below stand the parameters that several models share.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchbrdf.analytic.shading_geometry import ShadingGeometry

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

    def printed(self, value: float) -> str:
        """To four digits; below a millionth only where the logarithm is fitted: elsewhere that is as good as 0."""
        return f"{value:.4g}" if self.logarithmic else f"{round(value, 6) + 0.0:.4g}"


@dataclass(frozen=True)
class AnalyticModel:
    """A reciprocal BRDF with parameters.

    f_r               of a geometry (N, 1) and the parameters by name, see `models`; gives (N, 3) in 1/sr
    source            key in docs/references.bib
    channels_coupled  a channel of f_r depends on other channels of a colour
    energy_conserving no more is reflected than comes in, for any parameters within the bounds
    """

    name: str
    f_r: Callable[..., Tensor]
    parameters: tuple[Parameter, ...]
    source: str
    channels_coupled: bool = False
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


_ROUGHNESS_STARTS = (0.003, 0.01, 0.03, 0.1, 0.25, 0.5)

DIFFUSE = Parameter("diffuse", 0.0, 1.0, 0.5, colour=True)
SPECULAR_F0 = Parameter("specular", 0.0, 1.0, 0.04, colour=True)
WEIGHT = Parameter("specular", 0.0, 10.0, 1.0, colour=True)
ALPHA = Parameter("roughness", 1e-3, 1.0, 0.3, logarithmic=True, starts=_ROUGHNESS_STARTS)
SLOPE = replace(ALPHA, upper=3.0)
F0 = Parameter("f0", 0.0, 1.0, 0.04)
ETA = Parameter("eta", 1.01, 100.0, 1.5, logarithmic=True)
SHARPNESS = Parameter("sharpness", 1e-3, 1e6, 30.0, logarithmic=True, starts=(10.0, 100.0, 1e3, 1e4))

BASE_COLOR = Parameter("base_color", 0.0, 1.0, 0.5, colour=True)
METALLIC = Parameter("metallic", 0.0, 1.0, 0.1, starts=(0.1, 0.9))
ROUGHNESS = Parameter("roughness", 0.032, 1.0, 0.5, starts=(0.17, 0.3, 0.5, 0.7))
"""Its square is alpha, at least 0.001."""
