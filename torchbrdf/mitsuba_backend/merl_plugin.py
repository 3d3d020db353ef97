"""The Mitsuba plugin `merl`: a measured table as a BSDF.

    from torchbrdf.mitsuba_backend import register_merl
    register_merl()

after `mitsuba.set_variant`; then `{"type": "merl", "filename": "brass.binary"}` is a BSDF in any scene. Parameters:

    filename              MERL .binary file, relative paths as Mitsuba resolves them
    values                instead of a file: tensor (90, 90, 180, 3), f_r in 1/sr
    interpolation         "nearest" (default), as MERL's own code, or "linear" in the three warped coordinates
    half_vector_fraction  of the sampled directions that follow half vectors, the others follow the cosine;
                          default 0.5

`mitsuba.traverse` finds the table as `values` (90, 90, 180, 3); to set it compiles nothing anew.
"""

from collections.abc import Sequence
from functools import cache
from math import pi
from types import ModuleType
from typing import Any

import numpy as np

from torchbrdf.brdf import GRID, MerlTable
from torchbrdf.mitsuba_startup import is_vectorised, load_mitsuba

# Arrays, vectors, interactions and samples of Mitsuba have other types in each of its variants.
Array = Any

HALF_VECTOR_FRACTION = 0.5
"""Of the sampled directions, how many follow half vectors unless a scene says otherwise."""

_TINY = 1e-12


def register_merl() -> None:
    """Make the plugin `merl` known to Mitsuba, in the variant that is set; more than once does no harm."""
    mi = load_mitsuba()
    _register(mi.variant())


def merl_bsdf(table: MerlTable, interpolation: str = "nearest") -> dict[str, Array]:
    """A table as a BSDF in a Mitsuba scene dictionary."""
    if interpolation not in ("nearest", "linear"):
        raise ValueError(f'interpolation must be "nearest" or "linear", got {interpolation!r}')
    mi = load_mitsuba()
    register_merl()
    return {"type": "merl", "values": mi.TensorXf(table_values(table)), "interpolation": interpolation}


def table_values(table: MerlTable) -> np.ndarray:
    """(90, 90, 180, 3) float32: the table with its unmeasured cells filled."""
    return np.ascontiguousarray(table.filled.detach().cpu().float().reshape(*GRID, 3).numpy())


def cell_coordinates(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """theta_h, theta_d and phi_d of local directions in units of cells, phi_d from -180 to 180.

    With s = wi + wo and d = wo - wi: theta_h is the angle of s to the normal, tan(theta_d) = |d| / |s|, and phi_d
    the azimuth of d about s from the plane of s and the normal [Rus98]. A swap of wi and wo turns it by 180 cells.
    """
    import drjit as dr

    s, d = wi + wo, wo - wi
    length = dr.norm(s)
    theta_h = dr.atan2(_across(s), s.z)
    theta_d = dr.atan2(dr.norm(d), length)
    phi_d = dr.atan2((s.x * d.y - s.y * d.x) * length, -d.z * dr.squared_norm(s))
    return dr.sqrt(dr.maximum(theta_h, 0) * (2 / pi)) * GRID[0], theta_d * (GRID[1] * 2 / pi), phi_d * (GRID[2] / pi)


def _across(s: Array) -> Array:
    """Length of the part of a local vector that is normal to +Z."""
    import drjit as dr

    return dr.sqrt(dr.fma(s.x, s.x, s.y * s.y))


def cell_index(mi: ModuleType, h: Array, d: Array, p: Array) -> Array:
    """Flat cell of coordinates in units of cells; phi_d wraps around."""
    import drjit as dr

    p = p - GRID[2] * dr.floor(p / GRID[2])
    row, column, slab = (dr.clip(mi.Int32(dr.floor(c)), 0, n - 1) for c, n in zip((h, d, p), GRID, strict=True))
    return mi.UInt32((row * GRID[1] + column) * GRID[2] + slab)


def sample_direction(mi: ModuleType, wi: Array, chooses: Array, point: Array, fraction: float) -> Array:
    """A local direction: chooses < fraction asks for a half vector, else for the cosine.

    Half vectors have theta_h = u^2 pi/2, MERL's own warp, so that each row of its grid gets equally many.
    """
    import drjit as dr

    theta = point.x * point.x * (pi / 2)
    sin_h, cos_h = dr.sincos(theta)
    sin_p, cos_p = dr.sincos(2 * pi * point.y)
    h = mi.Vector3f(sin_h * cos_p, sin_h * sin_p, cos_h)
    mirrored = 2 * dr.dot(h, wi) * h - wi
    return dr.select(chooses < fraction, mirrored, mi.warp.square_to_cosine_hemisphere(point))


def direction_pdf(wi: Array, wo: Array, fraction: float) -> Array:
    """Density of `sample_direction` in 1/sr; meaningless below the horizon.

    For half vectors p(h) = 1 / (u pi 2 pi sin(theta_h)) and p(wo) = p(h) / (4 cos(theta_d)), u = sqrt(2 theta_h / pi).
    """
    import drjit as dr

    s = wi + wo
    sin_s = _across(s)
    u = dr.sqrt(dr.maximum(dr.atan2(sin_s, s.z), 0) * (2 / pi))
    by_half_vector = 1 / dr.maximum(4 * pi * pi * u * sin_s, _TINY)  # |s| = 2 cos(theta_d), sin_s = |s| sin(theta_h)
    return fraction * by_half_vector + (1 - fraction) * wo.z * (1 / pi)


@cache
def _register(variant: str) -> None:
    import drjit as dr
    import mitsuba as mi

    class MerlBSDF(mi.BSDF):
        """A measured table."""

        def __init__(self, props: Array) -> None:
            mi.BSDF.__init__(self, props)
            self.interpolation = str(props.get("interpolation", "nearest"))
            if self.interpolation not in ("nearest", "linear"):
                raise ValueError(f'merl: interpolation must be "nearest" or "linear", got {self.interpolation!r}')
            self.fraction = float(props.get("half_vector_fraction", HALF_VECTOR_FRACTION))
            if not 0 <= self.fraction < 1:
                raise ValueError(f"merl: half_vector_fraction must be in [0, 1), got {self.fraction}")
            self.values = _values(mi, props)
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def traverse(self, callback: Array) -> None:
            callback.put("values", self.values, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: Sequence[str] = ()) -> None:
            _check_shape(self.values)

        def _look_up(self, wi: Array, wo: Array, active: Array) -> Array:
            h, d, p = cell_coordinates(wi, wo)
            if self.interpolation == "nearest":
                return self._gather(cell_index(mi, h, d, p), active)
            total = mi.Color3f(0)
            low = [dr.floor(coordinate - 0.5) for coordinate in (h, d, p)]
            fraction = [c - 0.5 - at for c, at in zip((h, d, p), low, strict=True)]
            for corner in range(8):
                steps = [(corner >> axis) & 1 for axis in range(3)]
                weight = mi.Float(1)
                for f, step in zip(fraction, steps, strict=True):
                    weight = weight * (f if step else 1 - f)
                index = cell_index(mi, *(at + step for at, step in zip(low, steps, strict=True)))
                total += weight * self._gather(index, active)
            return total

        def _gather(self, index: Array, active: Array) -> Array:
            if is_vectorised(mi):
                return dr.gather(mi.Color3f, self.values.array, index, active)
            return mi.Color3f(*(self.values.array[3 * index + channel] for channel in range(3)))

        def sample(
            self, ctx: Array, si: Array, sample1: Array, sample2: Array, active: Array = True
        ) -> tuple[Array, Array]:
            wo = sample_direction(mi, si.wi, sample1, sample2, self.fraction)
            value, pdf = self.eval_pdf(ctx, si, wo, active)
            found: Array = dr.zeros(mi.BSDFSample3f)
            found.wo = wo
            found.pdf = pdf
            found.eta = 1.0
            found.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            found.sampled_component = 0
            return found, dr.select(pdf > 0, value / dr.maximum(pdf, _TINY), 0)

        def eval(self, ctx: Array, si: Array, wo: Array, active: Array = True) -> Array:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Array, si: Array, wo: Array, active: Array = True) -> Array:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Array, si: Array, wo: Array, active: Array = True) -> tuple[Array, Array]:
            active = active & (si.wi.z > 0) & (wo.z > 0) & ctx.is_enabled(mi.BSDFFlags.GlossyReflection)
            value = self._look_up(si.wi, wo, active) * wo.z
            return dr.select(active, value, 0), dr.select(active, direction_pdf(si.wi, wo, self.fraction), 0)

        def to_string(self) -> str:
            return f"merl[interpolation={self.interpolation}, half_vector_fraction={self.fraction}]"

    mi.register_bsdf("merl", MerlBSDF)


def _values(mi: ModuleType, props: Array) -> Array:
    """The table that the properties name, as a tensor of the variant set."""
    if "values" in props and "filename" not in props:
        values = props["values"]
        _check_shape(values)
        return values
    if ("filename" in props) == ("values" in props):
        raise ValueError('merl: give either "filename", a MERL .binary file, or "values", a tensor (90, 90, 180, 3)')
    path = mi.file_resolver().resolve(props["filename"])
    return mi.TensorXf(table_values(MerlTable.open(str(path))))


def _check_shape(values: Array) -> None:
    if tuple(values.shape) != (*GRID, 3):
        raise ValueError(f"merl: values must be {(*GRID, 3)}, got {tuple(values.shape)}")
