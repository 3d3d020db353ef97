"""The free numbers of an analytic fit: one flat vector, bounded, for the parameters of a model."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import torch
from torch import Tensor

from torchbrdf.analytic.model import AnalyticModel, Parameter, Parameters
from torchbrdf.analytic.shading_geometry import ShadingGeometry

_STEP = 1e-7
"""Of the differences that stand for derivatives, in float64: wrong by some 1e-7, which a least-squares step never sees.

Forward differentiation takes three times as long: torch asks a Python function for the shape of every zero tangent.
"""


@dataclass(frozen=True)
class Linearisation:
    """f_r of N pairs of directions, and how it changes along some directions of the vector.

    f_r       (N, 3)     1/sr
    tangents  (S, N, 3)  derivatives along the S rows of `FitVariables.seeds`, times signs
    signs     (V,)       -1 for variables that lie at their upper bound and were moved down
    """

    f_r: Tensor
    tangents: Tensor
    signs: np.ndarray


@dataclass(frozen=True)
class FitVariables:
    """The parameters of a model as a vector x of V numbers, logarithms where the model says so.

    shared  numbers that are no colours are the same for R, G and B; else each channel has its own
    """

    model: AnalyticModel
    shared: bool = True

    @cached_property
    def _slices(self) -> dict[str, slice]:
        slices, start = {}, 0
        for parameter in self.model.parameters:
            stop = start + self._width(parameter)
            slices[parameter.name] = slice(start, stop)
            start = stop
        return slices

    def _width(self, parameter: Parameter) -> int:
        return 3 if parameter.colour or not self.shared else 1

    def __len__(self) -> int:
        """V."""
        return sum(map(self._width, self.model.parameters))

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper ends (V,)."""
        parameters = self.model.parameters
        return self._vector([p.lower for p in parameters]), self._vector([p.upper for p in parameters])

    @cached_property
    def starts(self) -> tuple[np.ndarray, ...]:
        """Vectors to start from: every combination of the values that the parameters name, else their defaults."""
        return tuple(self._vector(one) for one in product(*(p.starts or (p.default,) for p in self.model.parameters)))

    def _vector(self, numbers: Sequence[float]) -> np.ndarray:
        values = torch.tensor(numbers, dtype=torch.float64).split(1)
        return self.vector({p.name: value for p, value in zip(self.model.parameters, values, strict=True)})

    def vector(self, parameters: Parameters) -> np.ndarray:
        """x (V,) float64 of parameters (1,) or (3,), which need not lie within the bounds.

        Raises ValueError where they are not those of the model, or are no numbers.
        """
        self.model.check(parameters)
        parts = []
        for p in self.model.parameters:
            value = parameters[p.name].detach().cpu().double()
            if value.shape not in ((1,), (self._width(p),)):
                raise ValueError(
                    f"{p.name} of {self.model.name} must be {self._width(p)} number{'s' * (self._width(p) > 1)} with "
                    f"shared={self.shared}, got {tuple(value.shape)}"
                )
            parts.append((torch.log(value) if p.logarithmic else value).expand(self._width(p)))
            if parts[-1].isnan().any():
                kind = "positive numbers" if p.logarithmic else "numbers"
                raise ValueError(f"{p.name} of {self.model.name} must be {kind}, got {value.tolist()}")
        return torch.cat(parts).numpy()

    def parameters(self, x: Tensor) -> dict[str, Tensor]:
        """Name -> (*batch, 1) or (*batch, 3) of vectors (*batch, V); differentiable."""
        taken = {p.name: x[..., self._slices[p.name]] for p in self.model.parameters}
        return {p.name: torch.exp(taken[p.name]) if p.logarithmic else taken[p.name] for p in self.model.parameters}

    def at_bounds(self, x: np.ndarray) -> tuple[str, ...]:
        """The names of parameters that lie at an end of their range, which end, and of which channel."""
        found = []
        for end, values in zip(("lower", "upper"), self.bounds, strict=True):
            close = np.abs(x - values) <= 1e-6 * (1 + np.abs(values))
            for p in self.model.parameters:
                hit = close[self._slices[p.name]]
                channels = "" if len(hit) == 1 or hit.all() else " of " + ", ".join(np.array(list("RGB"))[hit])
                if hit.any():
                    found.append(f"{p.name}{channels} at its {end} bound {getattr(p, end):g}")
        return tuple(found)

    @cached_property
    def seeds(self) -> np.ndarray:
        """(S, V): directions along which `linearise` differentiates.

        Where the channels are not coupled, the three numbers of a colour share one direction: each moves its own
        channel.
        """
        rows = []
        for p in self.model.parameters:
            units = np.eye(len(self))[self._slices[p.name]]
            rows.append(units if self.model.channels_coupled else units.sum(0, keepdims=True))
        return np.concatenate(rows)

    def linearise(self, x: np.ndarray, geometry: ShadingGeometry) -> Linearisation:
        """f_r and its tangents at x (V,) within the bounds, in the precision of the geometry, which is float64."""
        signs = np.where(x + _STEP > self.bounds[1], -1.0, 1.0)
        points = x + _STEP * signs * np.concatenate([np.zeros((1, len(self))), self.seeds])
        values = self.evaluate(torch.from_numpy(points), geometry)
        return Linearisation(values[0], (values[1:] - values[0]) / _STEP, signs)

    def evaluate(self, x: Tensor, geometry: ShadingGeometry) -> Tensor:
        """f_r (*batch, N, 3) at x (*batch, V) in the precision of the geometry; differentiable."""
        return self.model.evaluate(self.parameters(x.to(geometry.cos_i.dtype)), geometry)

    def jacobian(self, tangents: Tensor, signs: np.ndarray) -> np.ndarray:
        """(3 N, V) float64, pairs slow and channels fast, of tangents (S, N, 3) of anything of that shape.

        What stands for channel c depends on the numbers of channel c, where channels are not coupled.
        """
        columns = tangents.new_zeros(len(self), *tangents.shape[1:])
        row = 0
        for p in self.model.parameters:
            place = self._slices[p.name]
            width = place.stop - place.start
            if width == 1 or self.model.channels_coupled:
                columns[place] = tangents[row : row + width]
                row += width
            else:
                for c in range(3):
                    columns[place.start + c, :, c] = tangents[row, :, c]
                row += 1
        return columns.flatten(1).T.double().numpy() * signs
