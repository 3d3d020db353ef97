"""The scene around the ball for Mitsuba: stand, table and what lies on it; and pictures, the ball with more samples.

Units are radii of the ball. Table and stand are behind it and under it, where they hide little of the light.
"""

from collections.abc import Mapping
from math import ceil, isqrt
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from captures.placement import Frame, Placement
from captures.plans import MIRROR_REFLECTANCE, Plan
from torchbrdf.light import LightProbe
from torchbrdf.mitsuba_backend.scenes import SceneDict, light

CHROME: SceneDict = {"type": "conductor", "material": "none"}
CHROME_60: SceneDict = CHROME | {"specular_reflectance": {"type": "rgb", "value": [MIRROR_REFLECTANCE] * 3}}

_PATHS_AT_ONCE = 1 << 22
_DEPTH = 4


class CaptureScene:
    """A ball of a BSDF under a probe in the camera's frame, with the surroundings of a plan."""

    def __init__(self, mi: ModuleType, plan: Plan, probe: LightProbe, ball: Placement, bsdf: Mapping[str, Any]) -> None:
        """Build the scene."""
        self._mi, self._plan, self._ball = mi, plan, ball
        parts: SceneDict = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": _DEPTH, "rr_depth": _DEPTH + 1},
            "light": light(mi, probe),
            "ball": {"type": "sphere", "center": ball.centre.tolist(), "radius": 1.0, "bsdf": dict(bsdf)},
        }
        if not plan.alone:
            parts |= stand(mi, plan, ball) | table(mi, plan)
        self._scene = mi.load_dict(parts)

    def render(self, frame: Frame, samples: int, seed: int) -> Tensor:
        """Radiance (3, H, W) as a camera records it, none below zero, with some samples a pixel."""
        return self._window(frame, (slice(0, frame.height), slice(0, frame.width)), samples, seed)

    def with_ball(self, around: Tensor, frame: Frame, samples: int, seed: int) -> Tensor:
        """A picture of the same surroundings whose window of the ball is rendered anew."""
        image, window = around.clone(), self._ball.window(frame)
        image[:, *window] = self._window(frame, window, samples, seed)
        return image

    def _window(self, frame: Frame, window: tuple[slice, slice], samples: int, seed: int) -> Tensor:
        rows, columns = window
        height, width = rows.stop - rows.start, columns.stop - columns.start
        side = max(1, isqrt(min(samples, _PATHS_AT_ONCE // (height * width))))  # the sampler wants squares
        camera = self._mi.load_dict(sensor(self._mi, frame, window, self._plan.aperture, self._ball.distance - 0.5))
        total = np.zeros((height, width, 3))
        passes = ceil(samples / side**2)
        for index in range(passes):
            one_seed = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
            picture = self._mi.render(self._scene, sensor=camera, spp=side**2, seed=one_seed)
            total = total + np.asarray(picture)
        return torch.from_numpy(total / passes).permute(2, 0, 1).float().clamp_min(0)


def sensor(mi: ModuleType, frame: Frame, window: tuple[slice, slice], aperture: float, focus: float) -> SceneDict:
    """The camera of a window of the picture: linear RGB, means over the areas of pixels."""
    rows, columns = window
    film = {
        "type": "hdrfilm",
        "width": frame.width,
        "height": frame.height,
        "crop_offset_x": columns.start,
        "crop_offset_y": rows.start,
        "crop_width": columns.stop - columns.start,
        "crop_height": rows.stop - rows.start,
        "pixel_format": "rgb",
        "component_format": "float32",
        "filter": {"type": "box"},
    }
    pose = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, -1], up=[0, 1, 0])
    lens = (
        {"type": "thinlens", "aperture_radius": aperture, "focus_distance": focus}
        if aperture
        else {"type": "perspective"}
    )
    sampler = {"type": "multijitter"}
    clip = {"near_clip": 0.1, "far_clip": 1e4}
    return {**lens, "to_world": pose, "fov": frame.fov_deg, "fov_axis": "x", "film": film, "sampler": sampler, **clip}


def stand(mi: ModuleType, plan: Plan, ball: Placement) -> SceneDict:
    """A rod with a cup in which the ball lies."""
    generator = plan.generator("stand")
    x, y, z = ball.centre.tolist()
    grey = float(generator.uniform(0.05, 0.4))
    bsdf = _twosided(_diffuse([grey] * 3))
    radius, cup = float(generator.uniform(0.05, 0.08)), float(generator.uniform(0.13, 0.2))
    top = y - float(np.sqrt(1 - cup**2))
    rod = {"type": "cylinder", "p0": [x, top - 0.1, z], "p1": [x, y - 6, z], "radius": radius, "bsdf": bsdf}
    ring = {"type": "cylinder", "p0": [x, top - 0.15, z], "p1": [x, top + 0.02, z], "radius": cup, "bsdf": bsdf}
    pose = mi.ScalarTransform4f().translate([x, top - 0.15, z]).rotate([1, 0, 0], 90).scale(cup)
    bottom = {"type": "disk", "to_world": pose, "bsdf": bsdf}
    return {"rod": rod, "ring": ring, "bottom": bottom}


def table(mi: ModuleType, plan: Plan) -> SceneDict:
    """A textured table behind the ball, and textured boxes and cylinders on it."""
    generator = plan.generator("table")
    lowest = min(plan.ball.centre[1], plan.other_place.centre[1])
    near, far = plan.ball.distance + 14, plan.ball.distance + 55
    level = float(lowest - generator.uniform(1.8, 2.8))
    pose = mi.ScalarTransform4f().translate([0, level, -(near + far) / 2]).rotate([1, 0, 0], -90)
    pose = pose.scale([11, (far - near) / 2, 1])
    parts: SceneDict = {"table": {"type": "rectangle", "to_world": pose, "bsdf": _textured(mi, generator, 6)}}
    for i in range(int(generator.integers(5, 10))):
        z = float(generator.uniform(near + 2, far - 2))
        half = np.tan(np.radians(plan.frame.fov_deg) / 2) * z
        x = float(generator.uniform(-min(half, 10), min(half, 10)))
        width, depth, height = (float(generator.uniform(low, high)) for low, high in ((0.4, 1.4), (0.4, 1.4), (0.8, 4)))
        bsdf = _textured(mi, generator, 1)
        if generator.uniform() < 0.3:
            ends = {"p0": [x, level, -z], "p1": [x, level + height, -z]}
            parts[f"bottle{i}"] = {"type": "cylinder", **ends, "radius": width / 2, "bsdf": bsdf}
            continue
        pose = mi.ScalarTransform4f().translate([x, level + height / 2, -z])
        pose = pose.rotate([0, 1, 0], float(generator.uniform(0, 90))).scale([width / 2, height / 2, depth / 2])
        parts[f"box{i}"] = {"type": "cube", "to_world": pose, "bsdf": bsdf}
    return parts


def _diffuse(value: list[float]) -> SceneDict:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}


def _twosided(bsdf: SceneDict) -> SceneDict:
    return {"type": "twosided", "bsdf": bsdf}


def _textured(mi: ModuleType, generator: np.random.Generator, repeats: int) -> SceneDict:
    pixels = np.ascontiguousarray(pattern(generator), dtype=np.float32)
    bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.RGB)
    scale = mi.ScalarTransform4f().scale([repeats, repeats, 1])
    texture = {"type": "bitmap", "bitmap": bitmap, "raw": True, "to_uv": scale}
    return _twosided({"type": "diffuse", "reflectance": texture})


def pattern(generator: np.random.Generator, size: int = 128) -> np.ndarray:
    """(size, size, 3) reflectances: checks, stripes or clouds of two colours."""
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    kind = generator.choice(["checks", "stripes", "clouds"])
    step = int(generator.integers(6, 24))
    if kind == "checks":
        share = ((x // step + y // step) % 2).astype(float)
    elif kind == "stripes":
        share = 0.5 + 0.5 * np.sin(2 * np.pi * x / step + generator.normal(0, 0.4, size)[:, None].cumsum(0) % 6)
    else:
        share = _clouds(generator, size)
    dark = generator.uniform(0.02, 0.2, 3)
    return dark + share[..., None] * generator.uniform(0.2, 0.6, 3)


def _clouds(generator: np.random.Generator, size: int) -> np.ndarray:
    import cv2

    layers = []
    for cells in (4, 8, 16, 32, 64):
        coarse = generator.uniform(-1, 1, (cells, cells)).astype(np.float32) / cells**0.5
        layers.append(cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC))
    return np.clip(0.5 + np.sum(layers, axis=0), 0, 1)
