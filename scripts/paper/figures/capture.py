"""A photograph with what goes wrong in one: a dimpled ball on a stand, noise, a wrong exposure, a light probe turned.

Mitsuba renders the ball of a measured material (`measured`, `.bsdf`) with paths of up to four segments, so that the
stand covers the ball, shades it and is reflected in it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbrdf as tb
from make_targets import Quality as TargetQuality, render_halves
from torchbrdf.experiments import cap, tilt
from torchbrdf.mitsuba_backend import MitsubaScene
from torchbrdf.mitsuba_backend.scenes import light, sensor, shape
from torchbrdf.mitsuba_startup import load_mitsuba
from torchbrdf.photograph import Circle
from torchbrdf.rendering.directional import light_direction
from torchbrdf.view import TriangleMesh, to_mitsuba_mesh

_DIMPLE_AT = (0.42, 0.28, 0.863)
_DIMPLE_RADIUS, _DIMPLE_DEPTH = 0.16, 0.035
_STAND_RADIUS, _STAND_TOP, _STAND_FOOT = 0.5, -0.85, -4.0
_STAND_COLOUR = (0.35, 0.24, 0.15)
_MARGIN = 0.06
"""By how much a mask reaches beyond what is wrong, in radii of the ball."""

_STEPS = 256


@dataclass(frozen=True)
class Defects:
    """What is wrong with a photograph.

    noise     in per cent of every pixel
    exposure  radiance in the photograph over what the probe's units would make it
    degrees   by how much the probe is turned against the light of the photograph, about (1, 2, 2) / 3
    """

    dimple: bool = False
    stand: bool = False
    noise: float = 0.0
    exposure: float = 1.0
    degrees: float = 0.0


def recorded(probe: tb.LightProbe, defects: Defects) -> tb.LightProbe:
    """The probe as the user has it."""
    return probe.rotated(tilt(defects.degrees)) if defects.degrees else probe


@dataclass(frozen=True)
class Frame:
    """A square photograph in whose middle the ball is `ball` pixels wide, with a border of an eighth of that."""

    ball: int

    @property
    def border(self) -> int:
        """Pixels beside the ball."""
        return self.ball // 8

    @property
    def size(self) -> int:
        """Pixels along a side."""
        return self.ball + 2 * self.border

    @property
    def half_width(self) -> float:
        """In radii of the ball."""
        return self.size / self.ball

    @property
    def circle(self) -> Circle:
        """The silhouette of the ball."""
        return Circle(self.size / 2, self.size / 2, self.ball / 2)

    def cropped(self, image: Tensor) -> Tensor:
        """(..., ball, ball): the pixels of SphereView(ball)."""
        inside = slice(self.border, self.border + self.ball)
        return image[..., inside, inside]


def painted_mask(frame: Frame, defects: Defects) -> Tensor:
    """(1, size, size) bool: the ball less the dimple, the stand and its reflection, as one would paint it.

    The reflection is where a mirror ball would show the stand; all with a margin.
    """
    from scipy.ndimage import distance_transform_edt

    step = 2 / frame.ball
    axis = (torch.arange(frame.size, dtype=torch.float64) + 0.5) * step - frame.half_width
    y, x = torch.meshgrid(-axis, axis, indexing="ij")
    z = (1 - x * x - y * y).clamp_min(0).sqrt()
    ball = x * x + y * y < 1
    wrong = torch.zeros_like(ball)
    if defects.dimple:
        cosine = sum(a * b for a, b in zip(_DIMPLE_AT, (x, y, z), strict=True))
        wrong |= torch.as_tensor(cosine).clamp(-1, 1).acos() < _DIMPLE_RADIUS
    if defects.stand:
        covered = (x.abs() < _STAND_RADIUS) & (y < _STAND_TOP)
        mirrored = 2 * z * x, 2 * z * y, 2 * z * z - 1
        wrong |= covered | _meets_stand((x, y, z), mirrored)
    if wrong.any():
        wrong = torch.from_numpy(distance_transform_edt(~wrong.numpy()) * step <= _MARGIN)
    return (ball & ~wrong)[None]


Vectors = tuple[Tensor, Tensor, Tensor]


def _meets_stand(origin: Vectors, direction: Vectors) -> Tensor:
    """Whether rays meet the stand, an upright tube."""
    (x, y, z), (u, v, w) = origin, direction
    a, b, c = u * u + w * w, x * u + z * w, x * x + z * z - _STAND_RADIUS**2
    root = (b * b - a * c).clamp_min(0).sqrt()
    met = torch.zeros_like(x, dtype=torch.bool)
    for sign in (-1, 1):
        t = (-b + sign * root) / a.clamp_min(1e-12)
        height = y + t * v
        met |= (b * b > a * c) & (t > 1e-6) & (height < _STAND_TOP) & (height > _STAND_FOOT)
    return met


def dimpled_ball() -> TriangleMesh:
    """A unit sphere pressed in by DEPTH (1 - (a / RADIUS)^2)^2 at the angle a < RADIUS from the dimple's middle."""
    ball = cap(180, _STEPS)
    outward = ball.vertices.astype(float)
    middle = np.array(_DIMPLE_AT) / np.linalg.norm(_DIMPLE_AT)
    cosine = np.clip(outward @ middle, -1, 1)[:, None]
    a = np.arccos(cosine)
    share = np.minimum(a / _DIMPLE_RADIUS, 1)
    radius = 1 - _DIMPLE_DEPTH * (1 - share**2) ** 2
    slope = _DIMPLE_DEPTH * 4 * share * (1 - share**2) / _DIMPLE_RADIUS
    away = (outward * cosine - middle) / np.maximum(np.sin(a), 1e-9)
    normals = radius * outward - slope * away
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return TriangleMesh((radius * outward).astype(np.float32), normals.astype(np.float32), ball.faces, "dimpled ball")


class CaptureScene(MitsubaScene):
    """A ball of a measured material, wider than it fills the frame, with or without dimple and stand."""

    def __init__(self, bsdf: Mapping[str, Any], probe: tb.LightProbe, frame: Frame, defects: Defects) -> None:
        """Build the scene."""
        self._mi = mi = load_mitsuba()
        towards_camera = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, frame.size, frame.size)
        self.view = tb.NormalMapView(towards_camera)  # all pixels, and those around the ball
        camera = sensor(mi, tb.SphereView(frame.size))
        camera["to_world"] = camera["to_world"] @ mi.ScalarTransform4f().scale([frame.half_width, frame.half_width, 1])
        scene: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 4}, "sensor": camera}
        scene |= {"light": light(mi, probe), "ball": shape(mi, tb.SphereView(frame.size), bsdf)}
        if defects.dimple:
            scene["ball"] = to_mitsuba_mesh(mi, dimpled_ball(), mi.load_dict(dict(bsdf)))
        if defects.stand:
            wood = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(_STAND_COLOUR)}}
            scene["stand"] = {
                "type": "cylinder",
                "p0": [0, _STAND_FOOT, 0],
                "p1": [0, _STAND_TOP, 0],
                "radius": _STAND_RADIUS,
                "bsdf": {"type": "twosided", "bsdf": wood},
            }
        self.scene = mi.load_dict(scene)


def lit_ball(bsdf: Mapping[str, Any], view: tb.SphereView, angle_deg: float, samples: int) -> Tensor:
    """(3, N, N): a ball under a directional light, as `torchbrdf.render_directional` with an irradiance of pi."""
    scene = MitsubaScene(view, tb.LightProbe(torch.ones(3, 4, 8)), bsdf)
    mi = load_mitsuba()
    lamp = {"type": "directional", "direction": (-light_direction(angle_deg)).tolist(), "irradiance": pi}
    parts = {"type": "scene", "integrator": {"type": "direct"}, "sensor": sensor(mi, view), "lamp": lamp}
    scene.scene = mi.load_dict(parts | {"ball": shape(mi, view, bsdf)})
    return scene.render(samples).clamp_min(0)


def photograph_of(
    bsdf: Mapping[str, Any], probe: tb.LightProbe, frame: Frame, defects: Defects, quality: TargetQuality
) -> Tensor:
    """(3, size, size) radiance, before noise and exposure; colours that RGB cannot hold are cut off at 0."""
    halves, _ = render_halves(CaptureScene(bsdf, probe, frame, defects), quality, quality.seed)
    return halves.image.clamp_min(0)


def geometry() -> list[object]:
    """What a stored photograph depends on, besides its material, light and size."""
    return [_DIMPLE_AT, _DIMPLE_RADIUS, _DIMPLE_DEPTH, _STAND_RADIUS, _STAND_TOP, _STAND_FOOT, _STAND_COLOUR, _STEPS]
