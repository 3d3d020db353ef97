#!/usr/bin/env python3
"""Claim: in perspective, a mirror ball gives the light as well as its pixels tell it, from any place in a frame.

    python scripts/benchmarks/mirror_ball.py [--probes ennis dawn] [--size 720 480]

Mitsuba photographs mirror balls (perfect, of 60 %, of aluminium) under probes of ../shared/data with cameras of some
fields of view, some radii away and some degrees off their axes. The photograph is unwrapped as `torchbrdf probe` does
it, without and with what it shows beside the ball, and as if from infinity (`--probe-layout mirror_ball`), the rival.
Errors are relative ones, RMS over the sphere, after a blur of both by 1 and 5 degrees, and of rendered materials of the
embedded library, in the mean. "unseen" is the share of the sphere, and of the light, that was filled.
"""

import math
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.command_line import Parser
from torchbrdf.experiments import SHARED
from torchbrdf.images import relative_rms
from torchbrdf.light.mirror import Metal, MirrorPhotograph, unwrapped
from torchbrdf.mitsuba_backend.scenes import light
from torchbrdf.mitsuba_startup import load_mitsuba

MATERIALS = 8
VIEW = 64
SAMPLES = 128
CASES = (
    (24.0, 15.0, 0.0, "perfect"),
    (24.0, 15.0, 7.0, "perfect"),
    (50.0, 5.0, 0.0, "perfect"),
    (50.0, 5.0, 7.0, "60 %"),
    (50.0, 15.0, 7.0, "perfect"),
    (24.0, 15.0, 7.0, "Al"),
)
"""Field of view, distance in radii, degrees off the axis, what the ball is made of."""


def photographed(probe: tb.LightProbe, ball: Ball, made_of: str) -> Tensor:
    """(3, H, W): by Mitsuba."""
    mi = load_mitsuba()
    distance = 1 / math.sin(math.radians(ball.radius_deg))
    height, width = ball.camera.size
    pose = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, -1], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "filter": {"type": "box"}}
    film["component_format"] = "float32"
    bsdf: dict[str, object] = {"type": "conductor", "material": "Al" if made_of == "Al" else "none"}
    if made_of == "60 %":
        bsdf["specular_reflectance"] = {"type": "rgb", "value": 0.6}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {
                "type": "perspective", "to_world": pose, "fov": ball.camera.fov_deg, "fov_axis": "x", "film": film,
            },
            "light": light(mi, probe),
            "ball": {"type": "sphere", "center": [distance * each for each in ball.direction], "bsdf": bsdf},
        }
    )  # fmt: skip
    image = np.asarray(mi.render(scene, spp=SAMPLES, seed=0))
    return torch.from_numpy(image).permute(2, 0, 1).contiguous()


def from_infinity(image: Tensor, ball: Ball, factor: float) -> tb.LightProbe:
    """The rival: the circle of the silhouette, as if the camera were far away and looked at the ball."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chrome.exr"
        tb.write_image(path, image)
        return tb.LightProbe.open(path, "mirror_ball", circle=ball.circle, reflectance=factor)


def main() -> None:
    """Print the table."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("--probes", nargs="+", default=["ennis.hdr", "dawn.exr"], help="files of ../shared/data/probes")
    parser.add_argument("--size", type=int, nargs=2, default=[720, 480], help="width and height in pixels")
    options = parser.parse_args()
    whole = tb.MaterialLibrary.default()
    library = whole.subset(whole.names[:: len(whole.names) // MATERIALS])
    view = tb.SphereView(VIEW)
    print("| probe | fov | radii away | off the axis | ball | method | 1 deg | 5 deg | materials | unseen | s |")
    print("|---|---:|---:|---:|---|---|---:|---:|---:|---:|---:|")
    for name in options.probes:
        truth = tb.LightProbe.open(SHARED / "probes" / name)
        expected = tb.render_basis(library, truth, view).packed
        for fov, distance, off, made_of in CASES:
            camera = PinholeCamera.of_fov((options.size[1], options.size[0]), fov)
            turn = math.radians(off)
            direction = (0.8 * math.sin(turn), 0.6 * math.sin(turn), -math.cos(turn))
            ball = Ball(camera, direction, math.degrees(math.asin(1 / distance)))
            image = photographed(truth, ball, made_of)
            factor = 0.6 if made_of == "60 %" else 0.9 if made_of == "Al" else 1.0
            metal = Metal.open("Al") if made_of == "Al" else None
            photograph = MirrorPhotograph(image, ball)
            for method in ("in perspective", "and beside it", "from infinity"):
                start = time.perf_counter()
                unseen = ""
                if method == "from infinity":
                    probe = from_infinity(image, ball, factor)
                else:
                    found = unwrapped([photograph], metal or factor, beside=method == "and beside it")
                    probe = tb.LightProbe(found.radiance)
                    unseen = f"{found.share(found.filled):.1%}, {found.light(found.filled):.1%}"
                seconds = time.perf_counter() - start
                errors = [difference(probe, truth, blur) for blur in (1, 5)]
                got = tb.render_basis(library, probe, view).packed
                materials = sum(relative_rms(a, b) for a, b in zip(got, expected, strict=True)) / len(got)
                print(
                    f"| {name} | {fov:g} | {distance:g} | {off:g} | {made_of} | {method} | "
                    + " | ".join(f"{error:.3f}" for error in (*errors, float(materials)))
                    + f" | {unseen} | {seconds:.1f} |",
                    flush=True,
                )


def difference(probe: tb.LightProbe, truth: tb.LightProbe, blur: float) -> float:
    """Relative RMS over the sphere, both blurred."""
    found, expected = (each.resized(256).blurred(blur) for each in (probe, truth))
    weights = expected.solid_angles
    off = ((found.radiance - expected.radiance) ** 2 * weights).sum()
    return float((off / (expected.radiance**2 * weights).sum()).sqrt())


if __name__ == "__main__":
    main()
