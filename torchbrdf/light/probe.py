"""`LightProbe`: linear radiance from all directions, with rotation and importance sampling.

Lat-long, +Y up, direction (sin phi sin theta, cos theta, -cos phi sin theta), texels as in Mitsuba 3's
`envmap` (`torchbrdf.light.latlong`), so that a probe goes to both unchanged. Radiance between texels is bilinear.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.arguments import check_last, warn_of_lost_gradient
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, converted, luminance, write_image
from torchbrdf.lasting import lasting, lasting_graph, without_autocast
from torchbrdf.light._blur import blur
from torchbrdf.light._picture import KNOWN, LAMPS_KEY, ROWS_KEY, LightPicture, check_proportions
from torchbrdf.light._procedural import studio_room
from torchbrdf.light._sampling import ImportanceTables
from torchbrdf.light._soundness import sound
from torchbrdf.light.lamps import Lamps, bounded, lamps_of
from torchbrdf.light.latlong import bilinear, resize, rotate, row_solid_angles
from torchbrdf.light.rotations import checked_rotation
from torchbrdf.light.settings import Layout, Rows


class LightProbe:
    """An immutable light probe.

    radiance   (3, H, 2 H) linear RGB, any real floating-point type; kept as float32, on its device, and
               gradients flow back to it. Negative values are clamped to 0 with a warning
    repair     fill texels that hold a NaN or -infinity from their valid neighbours (a hole closes from its rim with
               means over 3 x 3 texels, across the seam in azimuth), with a warning; without it they are an error
    unknown_lamps  take infinite texels as clipped lamps, at the largest finite radiance, until `torchbrdf.align` finds
               theirs; without it they are an error
    name       what messages and `repr` call it
    raises     ValueError for another shape, invalid texels without `repair`, infinite ones without `unknown_lamps`, or
               a probe without energy
    """

    _reading = ""
    _infinite: Tensor | None = None

    def __init__(
        self,
        radiance: Tensor | np.ndarray,
        *,
        repair: bool = False,
        unknown_lamps: bool = False,
        name: str = "light probe",
    ) -> None:
        """Check `radiance` and keep a copy of it."""
        if isinstance(radiance, np.ndarray):
            radiance = torch.tensor(radiance)
        weights = _checked(radiance, name)
        radiance = radiance.to(torch.float32, copy=True)
        if unknown_lamps:
            radiance, self._infinite = bounded(radiance, weights, name)
        self._radiance = sound(radiance, weights, repair, name, unknown_lamps)
        self._name = name

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        layout: Layout = "latlong",
        repair: bool = False,
        height: int | None = None,
        *,
        rows: Rows | None = None,
        circle: tuple[float, float, float] | None = None,
        mask: Tensor | None = None,
        reflectance: float | Sequence[float] | None = None,
        fov_deg: float | None = None,
        primaries: ColourSpace = DEFAULT_SPACE,
        layer: str | None = None,
        unknown_lamps: bool = False,
    ) -> LightProbe:
        """Read a probe from an .exr or .hdr file.

        layout     "latlong"; "angular" (Debevec's `*_probe`: the centre looks along -Z, the rim is +Z); "mirror_ball"
                   (photograph of a chrome sphere: the centre reflects +Z); "vertical_cross" or "horizontal_cross" of
                   a cube (the centre looks along -Z); or "envmap_cube" of OpenEXR, which a file's attribute tells, too
        repair     as for the constructor
        height     rows of the result, by area means; default: for lat-long from pole to pole the file's; else at least
                   512, for lat-long a multiple of the file's
        rows       of a lat-long file: "centres", row y covers theta from pi y / H to pi (y + 1) / H; "poles", row y is
                   at pi y / (H - 1), as in Mitsuba and in this class. Default: what `save` or an `envmap` attribute
                   wrote into the file, else "centres"
        circle     x, y and radius of an "angular" or "mirror_ball" disc, in pixels from the top left corner; default:
                   the picture is square and tight around it
        mask       (1, h, w) bool, True where such a picture may be used; what the disc lacks is filled with `repair`,
                   and an error without it
        reflectance  of a mirror ball, 0 < r <= 1, one number or one for each of R, G and B: radiance is divided by it
        fov_deg    of a mirror ball: the horizontal field of view of its whole picture, which is then unwrapped in
                   perspective, into the frame of its camera; default: seen from infinity, in the middle
        primaries, layer  as for `read_image`
        unknown_lamps  as for the constructor
        raises     FileNotFoundError, ValueError
        """
        if height is not None:
            _checked_height(height)
        picture = LightPicture(
            Path(path), layout, rows, circle, mask, reflectance, fov_deg, primaries, layer, unknown_lamps
        )
        radiance, lamps, reading = picture.to_latlong(height, repair)
        return cls._of(radiance, lamps, picture.name, reading)

    @classmethod
    def default(cls, height: int = 128, primaries: ColourSpace = DEFAULT_SPACE) -> LightProbe:
        """The procedural probe: a studio room over five decades of radiance, lit from all sides; in a linear RGB."""
        room = converted(studio_room(_checked_height(height)), DEFAULT_SPACE, primaries)
        return cls._of(room.clone(), None, "default light probe")

    @classmethod
    def sky(
        cls,
        sun_elevation: float,
        turbidity: float = 3.0,
        *,
        sun_azimuth: float = 135.0,
        ground_albedo: float = 0.3,
        sun: bool = True,
        height: int = 256,
    ) -> LightProbe:
        """A clear sky with its sun, from Mitsuba's `sunsky`: the model of Hosek and Wilkie [HW12, HW13].

        sun_elevation  degrees above the horizon, 0 to 90
        turbidity      1 (clearest) to 10 (haze); 3 is a clear day in a temperate climate
        sun_azimuth    phi of this class in degrees: the sun is in direction (sin phi cos e, sin e, -cos phi cos e).
                       0 is -Z, behind the object; 90 is +X, at the right of the image; 180 is +Z, behind the camera.
                       Default: behind the camera on the right
        ground_albedo  0 to 1, of the ground as far as it brightens the sky. The ground itself is black
        sun            whether the sun's disc is included; the glow around it always is
        height         rows. The disc, 0.536 degrees wide, is spread over the texels that it meets, with its power
        Radiance is in W / (m^2 sr nm), a mean over the visible spectrum: 1 is about 73,000 cd / m^2. Negative values,
        of colours outside linear sRGB (very low suns), become 0. Raises ValueError for values out of range,
        MitsubaUnavailableError (an ImportError) where Mitsuba cannot be loaded.
        """
        from torchbrdf.light._sky import sky_radiance

        rows = _checked_height(height)
        radiance = sky_radiance(sun_elevation, turbidity, sun_azimuth, ground_albedo, sun, rows)
        name = f"sky with the sun at {sun_elevation:g} degrees, turbidity {turbidity:g}"
        return cls._of(cls(radiance, name=name).radiance, None, name)

    @property
    def radiance(self) -> Tensor:
        """(3, H, 2 H) float32; not to be written to."""
        return self._radiance

    @property
    def name(self) -> str:
        """What messages call it: from `open`, the file."""
        return self._name

    @property
    def reading(self) -> str:
        """How `open` took the file, in words, such as "rows at pixel centres"; empty for other probes."""
        return self._reading

    @cached_property
    def lamps(self) -> Lamps | None:
        """What of the radiance may be clipped, by the file or the array that it came from; `open` looks by itself."""
        with lasting_graph(self._radiance):
            return lamps_of(self._radiance, self.solid_angles, self._infinite)

    @property
    def height(self) -> int:
        """Rows of texels."""
        return self._radiance.shape[1]

    @property
    def width(self) -> int:
        """Columns of texels, twice the height."""
        return self._radiance.shape[2]

    @property
    def device(self) -> torch.device:
        """Where the radiance is."""
        return self._radiance.device

    @cached_property
    @lasting
    def solid_angles(self) -> Tensor:
        """(H, W) float64 in sr: the integral of each texel's bilinear hat; they sum to 4 pi.

        sum(radiance * solid_angles) is the exact integral of the bilinear radiance over the sphere.
        """
        return row_solid_angles(self.height, self.width, self.device)[:, None].expand(self.height, self.width)

    @property
    def total_power(self) -> Tensor:
        """(3,) float64: the integral of the radiance over the sphere."""
        return (self._radiance.double() * self.solid_angles).sum(dim=(1, 2))

    @property
    def mean_radiance(self) -> Tensor:
        """(3,) float64: the mean of the radiance over the sphere."""
        return self.total_power / (4 * math.pi)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the shape and the values, in hexadecimal: equal for equal probes, on any device."""
        values = self._radiance.detach().cpu().contiguous().numpy().astype("<f4", copy=False)
        return hashlib.sha256(f"{values.shape}".encode() + values.tobytes()).hexdigest()

    def radiance_at(self, directions: Tensor) -> Tensor:
        """Radiance (..., 3) from unit directions (..., 3): bilinear, differentiable in the radiance."""
        _check_places(directions, 3, "directions")
        return bilinear(self._radiance, directions)

    def sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        """Directions in proportion to the luminance, from points of the unit square.

        u          (..., 2) in [0, 1)
        returns    unit directions (..., 3) float32, and their density (...) in 1/sr, which is never 0.
                   Texels without energy are never met. The map is continuous but for jumps between rows and
                   columns, so stratified and quasi-random points keep their advantage
        """
        _check_places(u, 2, "u")
        directions, pdf = self._importance.sample(u.reshape(-1, 2))
        return directions.reshape(*u.shape[:-1], 3), pdf.reshape(u.shape[:-1])

    def pdf(self, directions: Tensor) -> Tensor:
        """The density (...) in 1/sr with which `sample` returns the unit directions (..., 3)."""
        _check_places(directions, 3, "directions")
        return self._importance.pdf(directions.reshape(-1, 3)).reshape(directions.shape[:-1])

    def rotated(self, rotation: Tensor | np.ndarray) -> LightProbe:
        """The probe turned: radiance that came from d now comes from R d.

        rotation   (3, 3), orthonormal with determinant +1
        Resampled by area means of bilinear lookups, which soften edges by less than a texel and keep the
        energy to 0.02 % (1 % where a few texels at a pole hold most of it: Grace Cathedral); a turn about +Y by
        whole texels is exact. Differentiable in the radiance; `HarmonicBasis.basis_at` is in the rotation, too.
        """
        if isinstance(rotation, Tensor):
            warn_of_lost_gradient(rotation, "the rotation of a light probe", "HarmonicBasis.basis_at carries it")
        return self._derived(partial(rotate, rotation=checked_rotation(rotation)))

    def scaled(self, factor: float) -> LightProbe:
        """The probe with its radiance times `factor` > 0."""
        if not (math.isfinite(factor) and factor > 0):
            raise ValueError(f"scale of a light probe must be positive and finite, got {factor}")
        return self._derived(lambda radiance: radiance * factor)

    def blurred(self, degrees: float) -> LightProbe:
        """The probe out of focus: a Gaussian with this standard deviation >= 0 along any direction; keeps energy."""
        if not (math.isfinite(degrees) and degrees >= 0):
            raise ValueError(f"blur of a light probe must be at least 0 degrees and finite, got {degrees}")
        return self._derived(partial(blur, sigma=math.radians(degrees))) if degrees else self

    def resized(self, height: int) -> LightProbe:
        """The probe with another number of rows, by means over each new texel's footprint."""
        if _checked_height(height) == self.height:
            return self
        return self._derived(partial(resize, height=height))

    def relit(self, factors: Tensor) -> LightProbe:
        """The probe with the radiance of its `lamps` times factors (3,) >= 0; they are known then, and None.

        Raises ValueError where it has no lamps, or for other factors.
        """
        if self.lamps is None:
            raise ValueError(f"{self._name} has no texels that may be clipped")
        if factors.shape != (3,) or not bool((torch.isfinite(factors) & (factors >= 0)).all()):
            raise ValueError(f"factors of lamps must be three finite numbers of at least 0, got {factors.tolist()}")
        more = (factors.to(self._radiance) - 1)[:, None, None] * self.lamps.radiance
        return self._of((self._radiance + more).clamp_min(0), None, self._name, self._reading)

    def save(
        self,
        path: str | os.PathLike[str],
        primaries: ColourSpace = DEFAULT_SPACE,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """Write the radiance as an .exr file that says that its rows run from pole to pole; `open` gives it back.

        Lamps of unknown radiance are infinite in it.
        primaries  the colour space of the radiance, which the file then names
        metadata   further attributes, by name
        raises     ValueError for another suffix or an unknown colour space, OSError where the file cannot be written
        """
        if Path(path).suffix.lower() != ".exr":
            raise ValueError(f"{path}: a light probe is saved as .exr, which can say how its rows lie; name it .exr")
        known = {} if self.lamps is not None else {LAMPS_KEY: KNOWN}
        radiance = self._radiance
        if self.lamps is not None and self.lamps.unknown:
            radiance = torch.where(self.lamps.radiance > radiance / 2, math.inf, radiance)
        write_image(path, radiance, {**(metadata or {}), ROWS_KEY: "poles", **known}, primaries=primaries)

    def to(self, device: torch.device | str) -> LightProbe:
        """The probe on another device."""
        if self._radiance.to(device) is self._radiance:
            return self
        return self._derived(lambda radiance: radiance.to(device))

    def __repr__(self) -> str:
        """Size, range and mean, for people."""
        bright, mean = luminance(self._radiance.detach()), float(luminance(self.mean_radiance.detach()))
        device = "" if self.device.type == "cpu" else f", on {self.device}"
        span = f"luminance {bright[bright > 0].min():.3g} to {bright.max():.4g}, mean {mean:.3g}"
        return f"LightProbe({self._name!r}, {self.height} x {self.width}, {span}{device})"

    @cached_property
    @lasting
    def _importance(self) -> ImportanceTables:
        return ImportanceTables.build(self._radiance)

    @without_autocast
    def _derived(self, changed: Callable[[Tensor], Tensor]) -> LightProbe:
        """The probe after a linear change of radiance (channels, H, 2 H), which its lamps go through, too."""
        if self.lamps is None:
            return self._of(changed(self._radiance), None, self._name, self._reading)
        both = changed(torch.cat([self._radiance, self.lamps.radiance]))
        return self._of(both[:3], self.lamps.of(both[3:]), self._name, self._reading)

    @classmethod
    def _of(cls, radiance: Tensor, lamps: Lamps | None, name: str, reading: str = "") -> LightProbe:
        probe = object.__new__(cls)
        probe._radiance, probe._name, probe._reading = radiance, name, reading
        probe.__dict__["lamps"] = lamps
        return probe


def _checked(radiance: Tensor, name: str) -> Tensor:
    """Solid angles (H, 1) of the texels of what is a probe by its shape and type."""
    if not isinstance(radiance, Tensor):
        remedy = "; open a file with tb.LightProbe.open(path)" if isinstance(radiance, str | os.PathLike) else ""
        raise ValueError(f"{name} must be a tensor or an array (3, H, W), got {type(radiance).__name__}{remedy}")
    if radiance.ndim != 3 or radiance.shape[0] != 3:
        advice = "; permute it: movedim(-1, 0)" if radiance.ndim == 3 and radiance.shape[2] == 3 else ""
        raise ValueError(f"{name} must be (3, H, W) linear RGB, got {tuple(radiance.shape)}{advice}")
    _, h, w = radiance.shape
    check_proportions(h, w, name)
    if not radiance.is_floating_point():
        raise ValueError(f"{name} must hold linear floating-point radiance, got {radiance.dtype}")
    return row_solid_angles(h, w, radiance.device)[:, None]


def _checked_height(height: int) -> int:
    if height < 2:
        raise ValueError(f"height of a light probe must be at least 2, got {height}")
    return height


def _check_places(values: Tensor, size: int, what: str) -> None:
    """Raise ValueError for directions or points that are not (..., size), or not finite."""
    check_last(values, size, what)
    if not torch.isfinite(values.detach().sum(dtype=torch.float32)):  # one pass: a sum keeps NaN
        raise ValueError(f"{what} must be finite, got NaN or infinity in {tuple(values.shape)}; leave those out")
