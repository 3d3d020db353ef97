"""`LightPaths`: what Mitsuba says about paths from camera points to a probe, for all BRDFs at once.

Every path takes two directions of light: one that Mitsuba's `envmap` samples, and one that the plugin `merl`
samples, joined by the balance heuristic, as Mitsuba's `direct` integrator joins them [VG95]. What is left of a
path is the cell of the MERL grid that it looks up and a weight: sr times radiance, so that the radiance of a
pixel with any table is the mean over its paths of weight times f_r(cell).
"""

from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from torchbrdf.light import LightProbe
from torchbrdf.mitsuba_backend.merl_plugin import (
    HALF_VECTOR_FRACTION,
    Array,
    cell_coordinates,
    cell_index,
    direction_pdf,
    sample_direction,
)
from torchbrdf.mitsuba_backend.scenes import light
from torchbrdf.mitsuba_startup import is_vectorised, load_mitsuba
from torchbrdf.transport import TransportSamples
from torchbrdf.view import View

N_NUMBERS = 7
"""Random numbers that a path needs: two for the pixel, two for the light, three for the BSDF."""


class LightPaths:
    """Paths between the points of a view and a probe.

    Geometry and shadows are the view's own; the light, its sampling and densities are Mitsuba's.
    """

    def __init__(self, view: View, probe: LightProbe) -> None:
        """Give the probe to Mitsuba."""
        self.view = view
        self._mi = load_mitsuba()
        self._scene = self._mi.load_dict({"type": "scene", "light": light(self._mi, probe)})

    def trace(self, pixels: Tensor, numbers: Tensor) -> TransportSamples:
        """Two weighted cells for every path.

        pixels   (Q,)       flat indices under the mask
        numbers  (7, Q, S)  uniform in [0, 1)
        returns  cells (Q, 2 S) and weights (3, Q, 2 S), whose sum over a pixel is the radiance times S
        """
        points = self.view.surface(pixels, numbers[0], numbers[1])
        inputs = torch.cat([points.normals, points.view_dirs, numbers[2:]]).flatten(1)
        found = self._connected(inputs.float().contiguous()).view(2, 7, *numbers.shape[1:])
        cells, directions, weights = found[:, 0].to(torch.int32), found[:, 1:4], found[:, 4:]
        lit = [self.view.visibility(points, w_i) for w_i in directions]
        weights = torch.stack([w if seen is None else w * seen for w, seen in zip(weights, lit, strict=True)])
        return TransportSamples(torch.cat([*cells], 1), torch.cat([*weights], 2))

    def _connected(self, inputs: Tensor) -> Tensor:
        """(14, N) float32: for either direction the cell (below 2^24: exact), w_i in world space and the weight."""
        mi = self._mi
        if is_vectorised(mi):
            found = self._connect(mi, *(mi.Float(row) for row in inputs))
            return torch.stack([mi.Float(row).torch() for row in _components(found)])
        return torch.tensor([_components(self._connect(mi, *path)) for path in inputs.T.tolist()]).T

    def _connect(self, mi: ModuleType, *values: Array) -> list[tuple[Array, Array, Array]]:
        """Cell, direction and weight of the light's and of the BSDF's direction."""
        import drjit as dr

        n, w_o = mi.Normal3f(*values[:3]), mi.Vector3f(*values[3:6])
        frame = mi.Frame3f(n)
        point = dr.zeros(mi.SurfaceInteraction3f)
        point.n = n
        point.wi = frame.to_local(w_o)
        environment = self._scene.environment()

        by_light, _ = environment.sample_direction(point, mi.Point2f(*values[6:8]))
        local = sample_direction(mi, point.wi, values[8], mi.Point2f(*values[9:11]), HALF_VECTOR_FRACTION)
        found = []
        for w_i in (by_light.d, frame.to_world(local)):
            wo = frame.to_local(w_i)
            toward = mi.DirectionSample3f()
            toward.d = w_i
            beyond = dr.zeros(mi.SurfaceInteraction3f)
            beyond.wi = -w_i
            density = environment.pdf_direction(point, toward) + direction_pdf(point.wi, wo, HALF_VECTOR_FRACTION)
            seen = (point.wi.z > 0) & (wo.z > 0) & (density > 0)
            weight = dr.select(seen, environment.eval(beyond) * (wo.z / density), 0)
            cell = cell_index(mi, *cell_coordinates(point.wi, wo))
            found.append((dr.select(seen, cell, 0), w_i, weight))
        return found


def _components(found: list[tuple[Array, Array, Array]]) -> list[Any]:
    """The fourteen numbers of `_connected` in their order."""
    return [c for cell, w_i, weight in found for c in (cell, w_i.x, w_i.y, w_i.z, weight.x, weight.y, weight.z)]
