"""Which captures there are: materials, lights, and everything else about each, drawn from its name and a seed."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import radians
from typing import Any

import numpy as np
import torch
from torch import Tensor

from captures.placement import Frame, Placement, towards
from captures.recording import RESPONSES
from torchbrdf.light import rotation_of, rotation_vector

FORMAT = "torchbrdf capture 1"

MATERIALS = {
    "design": (
        "acrylic_felt_pink_rgb", "cc_ibiza_sunset_rgb", "cm_toxic_green_rgb", "ilm_solo_m_68_rgb", "satin_purple_rgb",
        "cc_green_malachite_rgb", "cm_military_green_rgb",
    ),
    "report": (
        "aurora_white_rgb", "cg_sunflower_rgb", "colodur_connemara_4c_rgb", "leaf_maple_rgb", "vch_golden_yellow_rgb",
        "chm_orange_rgb", "irid_flake_paint1_rgb", "irid_flake_paint1_fine_rgb", "vch_silk_blue_rgb",
    ),
}  # fmt: skip
"""No family of materials (the first part of a name) is in both. The first five are split as in docs/alignment.md."""

PROBES = {"design": ("ennis", "forest", "dawn"), "report": ("apartment", "grace", "venice", "uffizi")}
"""Lights of the photographs; under all the others of both sets, results are shown."""

MIRROR_REFLECTANCE = 0.6


@dataclass(frozen=True)
class Plan:
    """One capture.

    material, probe  names
    frame, ball      the photograph's, and of the mirror ball `chrome`
    other_place      of the mirror ball `chrome60`, which reflects MIRROR_REFLECTANCE
    turn             (3,) the rotation vector of the probe into the camera's frame, radians
    sun              None, or where a sun stands in that frame (3,) and its share of the light
    aperture         radius of the lens in radii of the ball; 0: all is sharp
    response         "srgb" or "s-curve"
    suffix           of the brackets, ".jpg" or ".png"
    clip             factor by which the brightest texels of probe_clipped.exr are too dark
    misturn          (3,) rotation vector of probe_turned.exr against the truth, radians
    shift            of each bracket but one, pixels at most
    alone            nothing but the ball and the light
    seed             of all that is random in the scene and the camera
    """

    name: str
    material: str
    probe: str
    frame: Frame
    ball: Placement
    other_place: Placement
    turn: tuple[float, ...]
    sun: tuple[tuple[float, float, float], float] | None
    aperture: float
    response: str
    suffix: str
    clip: float
    misturn: tuple[float, ...]
    shift: float
    alone: bool
    seed: int

    def generator(self, what: str) -> np.random.Generator:
        """Random numbers for one purpose."""
        return np.random.default_rng(number_of(f"{self.seed} {self.name} {what}"))

    @property
    def rotation(self) -> Tensor:
        """(3, 3), as `LightProbe.rotated` takes it."""
        return rotation_of(torch.tensor(self.turn, dtype=torch.float64))

    def described(self) -> dict[str, Any]:
        """As JSON holds it."""
        return dict(json.loads(json.dumps(asdict(self))))


def number_of(text: str) -> int:
    """A seed that differs between texts."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "little")


def plans_of(
    materials: Sequence[str], probes: Sequence[str], count: int, frame: Frame, seed: int, shift: float, alone: bool
) -> list[Plan]:
    """`count` captures that go through the materials and, at another pace, through the probes."""
    plans = []
    for i in range(count):
        turn_of_all = i // len(materials)
        material, probe = materials[i % len(materials)], probes[(i + turn_of_all) % len(probes)]
        name = f"{i:02d}-{material.removesuffix('_rgb')}-{probe}"
        plans.append(_drawn(name, material, probe, frame, seed, sunny=i % 3 == 2))
    return [replace(plan, shift=shift, alone=alone) for plan in plans]


def _drawn(name: str, material: str, probe: str, frame: Frame, seed: int, sunny: bool) -> Plan:
    generator = np.random.default_rng(number_of(f"{seed} {name} plan"))
    uniform = generator.uniform
    ball = _somewhere(generator, frame)
    places = [_somewhere(generator, frame) for _ in range(8)]
    other = max(places, key=lambda place: _apart(place, ball))
    yaw, tilt = uniform(-np.pi, np.pi), generator.normal(0, radians(3), 2)
    about_y = rotation_of(torch.tensor([0.0, yaw, 0.0], dtype=torch.float64))
    rotation = rotation_of(torch.tensor([tilt[0], 0.0, tilt[1]], dtype=torch.float64)) @ about_y
    up, aside = uniform(20, 65), uniform(-110, 110)
    sun = towards_sun(up, aside), float(uniform(0.3, 0.6))
    axis = generator.normal(size=3)
    return Plan(
        name=name,
        material=material,
        probe=probe,
        frame=frame,
        ball=ball,
        other_place=other,
        turn=tuple(rotation_vector(rotation).tolist()),
        sun=sun if sunny else None,
        aperture=float(generator.choice([0.0, 0.06, 0.12])),
        response=str(generator.choice(RESPONSES)),
        suffix=str(generator.choice([".jpg", ".png"])),
        clip=float(np.exp(uniform(np.log(2), np.log(1000)))),
        misturn=tuple((radians(2) * axis / np.linalg.norm(axis)).tolist()),
        shift=0.0,
        alone=False,
        seed=seed,
    )


def _somewhere(generator: np.random.Generator, frame: Frame) -> Placement:
    """14 to 16 radii away for 24 degrees (as large in the picture for others), wholly in the frame."""
    distance = float(generator.uniform(14, 16)) * np.tan(radians(12)) / np.tan(radians(frame.fov_deg) / 2)
    distance = max(float(distance), 2.0)
    half_width = frame.fov_deg / 2
    half_height = float(np.degrees(np.arctan(frame.height / 2 / frame.focal)))
    radius = float(np.degrees(np.arcsin(1 / distance)))
    spare = 1.05 * radius * (1 + np.tan(radians(half_width)) ** 2)  # the ellipse grows towards the corners
    x = max(0.0, min(7.0 * frame.fov_deg / 24, half_width - spare))
    y = max(0.0, min(7.0 * frame.fov_deg / 24, half_height - spare))
    return Placement(towards(float(generator.uniform(-x, x)), float(generator.uniform(-y, y))), distance)


def _apart(one: Placement, other: Placement) -> float:
    return -float(np.dot(one.direction, other.direction))


def towards_sun(up_deg: float, aside_deg: float) -> tuple[float, float, float]:
    """The direction so far above the horizon, and to the right of +Z, which is behind the camera."""
    up, aside = radians(up_deg), radians(aside_deg)
    x, y, z = np.sin(aside) * np.cos(up), np.sin(up), np.cos(aside) * np.cos(up)
    return float(x), float(y), float(z)
