#!/usr/bin/env python3
"""Photographs as a person's camera would take them, by Mitsuba: balls in their surroundings, mirror balls, brackets.

    python scripts/make_captures.py --set design -o captures/design
    python scripts/make_captures.py --set report -o captures/report

A pinhole camera of 720 x 480 pixels and 24 degrees stands before a ball 14 to 16 radii away and up to 7 degrees off its
axis, on a stand, with a textured table and things on it behind. The materials are measured ones that Mitsuba reads
(.bsdf); a light probe turned into the camera's frame, in every third capture with a sun added, is light and background.
Each capture is a folder:

photo.exr         linear radiance, with 1 % noise (shot and read)
chrome.exr        a perfect mirror ball in the place of the ball; chrome60.exr: one that reflects 60 %, elsewhere
photo_*.jpg|png   brackets of 8 bits of photo.exr, chrome_* of chrome.exr: response curve, clipped, EXIF times and lens
probe.exr         the true light in the camera's frame; probe_turned.exr: turned by 2 degrees; probe_clipped.exr: its
                  brightest texels too dark by a factor
ideal.exr         what the method wants: an orthographic sphere of 64 x 64 pixels, 1 % noise; ideal_clean.exr without
truth.json        material, probe, camera, where the balls are (direction, ellipse, circle), exposures, clipping

OUT/targets/PROBE/MATERIAL.exr are the materials under all probes, OUT/lights/PROBE.exr these probes, for
scripts/benchmarks/capture.py. Everything is drawn from --seed and the capture's name; folders are whole or absent:
interrupted, the same command goes on where it stopped. A capture takes about a minute; --no-targets leaves OUT/targets
out, which take longer.
"""

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from captures.lights import clipped, light_of, misturned
from captures.placement import Frame, Placement
from captures.plans import FORMAT, MATERIALS, MIRROR_REFLECTANCE, PROBES, Plan, plans_of
from captures.recording import brackets_of, described, noisy, recorded, write_bracket
from captures.scenes import CHROME, CHROME_60, CaptureScene
from make_targets import Material, Quality, analytic_materials, asked_for, make_target, make_targets, measured_materials
from torchbrdf.command_line import BAD_INPUT, RESUMABLE, Parser, exit_status, fail
from torchbrdf.experiments import SHARED, Target, noisy_observations, open_probes
from torchbrdf.experiments.probes import PROBES as ALL_PROBES
from torchbrdf.files import replacing_folder
from torchbrdf.images import write_image
from torchbrdf.mitsuba_startup import load_mitsuba

TRUTH = "truth.json"
TARGET_NOISE = 0.015
MOST_TARGET_SAMPLES = 1 << 16
ANALYTIC_SET = ("blue-billiard", "copper-blasted", "terracotta", "white-plastic")


def make_capture(
    folder: Path, plan: Plan, material: Material, probe: tb.LightProbe, samples: int, ball_samples: int, size: int
) -> None:
    """Render a capture and write its files."""
    mi, light = load_mitsuba(), light_of(plan, probe)
    margin = math.ceil(plan.shift) + 2 if plan.shift else 0
    frame = plan.frame.widened(margin)
    inside = slice(margin, margin + plan.frame.height), slice(margin, margin + plan.frame.width)
    truth: dict[str, Any] = {"format": FORMAT, "plan": plan.described(), "material": plan.material, "probe": plan.probe}

    def rendered(ball: Placement, bsdf: Mapping[str, Any], what: str, around: Tensor | None = None) -> Tensor:
        seed = int(plan.generator(what).integers(1 << 40))
        scene = CaptureScene(mi, plan, light, ball, bsdf)
        around = scene.render(frame, samples, seed) if around is None else around
        return scene.with_ball(around, frame, ball_samples, seed + 1)

    photo = rendered(plan.ball, material.bsdf, "photo")
    chrome = rendered(plan.ball, CHROME, "chrome", around=photo)
    chrome_60 = rendered(plan.other_place, CHROME_60, "chrome60")
    on_ball = photo[:, *plan.ball.window(frame, margin=-int(0.15 * plan.ball.ellipse(frame).b))].flatten(1)
    level = float(on_ball.mean())
    for name, image in (("photo", photo), ("chrome", chrome), ("chrome60", chrome_60)):
        generator = plan.generator(f"noise of {name}")
        write_image(folder / f"{name}.exr", noisy(image[:, *inside], level, generator))
        if name == "chrome60":
            continue
        ball = image[:, *plan.ball.window(frame)].flatten(1)
        exposures = brackets_of(image, ball, level, plan.shift, generator)
        files = [f"{name}_{i}{plan.suffix}" for i in range(len(exposures))]
        for file, exposure in zip(files, exposures, strict=True):
            pixels = recorded(image, level, exposure, plan.response, margin, generator)
            write_bracket(folder / file, pixels, exposure, plan.frame.fov_deg)
        truth[f"{name}_brackets"] = described(files, exposures)
    light.save(folder / "probe.exr")
    misturned(plan, light).save(folder / "probe_turned.exr")
    clipping = clipped(light, plan.clip)
    clipping.probe.save(folder / "probe_clipped.exr")
    write_ideal(folder, plan, material, light, size)
    truth |= {
        "fov_deg": plan.frame.fov_deg,
        "size": [plan.frame.height, plan.frame.width],
        "focal_pixels": plan.frame.focal,
        "rotation": plan.rotation.tolist(),
        "sun": plan.sun,
        "response": plan.response,
        "level": level,
        "ball": plan.ball.described(plan.frame),
        "chrome": plan.ball.described(plan.frame) | {"reflectance": 1.0},
        "chrome60": plan.other_place.described(plan.frame) | {"reflectance": MIRROR_REFLECTANCE},
        "turned_by": list(plan.misturn),
        "clipped": clipping.described(),
        "probe_fingerprint": light.fingerprint,
    }
    (folder / TRUTH).write_text(json.dumps(truth, indent=1))


def write_ideal(folder: Path, plan: Plan, material: Material, light: tb.LightProbe, size: int) -> None:
    """The observation that the method wants, without and with noise."""
    path, quality = folder / "ideal_clean.exr", Quality(size, samples=1024, seed=plan.seed, max_samples=1 << 14)
    make_target(path, material, light, quality, asked_for(material, plan.name, light, quality))
    clean = Target.open(path).photograph
    write_image(folder / "ideal.exr", noisy_observations(clean, [1.0], f"{plan.seed} {plan.name} ideal")[0].float())


def is_there(folder: Path, plan: Plan) -> bool:
    """Whether a folder holds the capture of a plan."""
    path = folder / TRUTH
    if not path.exists():
        return False
    return bool(json.loads(path.read_text()).get("plan") == plan.described())


def materials_of(name: str, folder: Path) -> list[Material]:
    """The materials of a set; measured ones from the folders `rgl` and `rgl_more` of the data."""
    if name == "analytic":
        return [material for material in analytic_materials() if material.name in ANALYTIC_SET]
    found = {one.name: one for part in ("rgl", "rgl_more") for one in measured_materials(folder / part)}
    missing = [wanted for wanted in MATERIALS[name] if wanted not in found]
    if missing:
        raise ValueError(f"{folder}: no {missing[0]}.bsdf in rgl or rgl_more; get it, or choose another --set")
    return [found[wanted] for wanted in MATERIALS[name]]


def probes_of(name: str, folder: Path) -> dict[str, tb.LightProbe]:
    """All probes by name."""
    if name == "analytic":
        room = tb.LightProbe.default()
        turns = {"room": [1.0, 1.0, 1.0], "back": [-1.0, 1.0, -1.0], "below": [1.0, -1.0, -1.0]}
        return {key: room.rotated(torch.diag(torch.tensor(turn))) for key, turn in turns.items()}
    return open_probes([folder / "probes" / file for file in ALL_PROBES])


def save_lights(folder: Path, probes: Mapping[str, tb.LightProbe]) -> None:
    """The probes under which there are targets, as this program reads them."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, probe in probes.items():
        probe.save(folder / f"{name}.exr")


def run(options: argparse.Namespace) -> int:
    load_mitsuba()
    materials = {one.name: one for one in materials_of(options.set, options.data)}
    probes = probes_of(options.set, options.data)
    lights = PROBES.get(options.set, ("room",))
    height, width = options.size
    frame = Frame(height, width, options.fov)
    plans = plans_of(list(materials), lights, options.count, frame, options.seed, options.shift, options.alone)
    with tqdm(plans, desc="captures") as bar:
        for plan in bar:
            bar.set_postfix_str(plan.name)
            folder = options.output / plan.name
            if is_there(folder, plan):
                continue
            options.output.mkdir(parents=True, exist_ok=True)
            with replacing_folder(folder, "choose another folder") as temporary:
                make_capture(
                    temporary, plan, materials[plan.material], probes[plan.probe], options.samples,
                    options.ball_samples, options.ideal_size,
                )  # fmt: skip
    if not options.no_targets:
        save_lights(options.output / "lights", probes)
    used = [materials[name] for name in dict.fromkeys(plan.material for plan in plans)]
    quality = Quality(options.ideal_size, options.target_samples, TARGET_NOISE, MOST_TARGET_SAMPLES, options.seed)
    made = [] if options.no_targets else list(make_targets(options.output / "targets", used, probes, quality))
    problems = [problem for _, problem in made if problem is not None]
    for problem in problems:
        fail("make_captures", problem)
    print(f"{len(plans)} captures of {len(used)} materials in {options.output}")
    return BAD_INPUT if problems else 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    sets = [*MATERIALS, "analytic"]
    text = "materials and lights to choose on, to report on, or built-in ones that need no data; default: design"
    parser.add_argument("--set", choices=sets, default="design", help=text)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the captures")
    parser.add_argument(
        "--data", type=Path, default=SHARED, help="folder of rgl, rgl_more and probes; default: ../shared/data"
    )
    parser.add_argument("--count", type=int, default=12, help="captures; default: 12")
    parser.add_argument(
        "--size", type=int, nargs=2, default=(480, 720), metavar=("H", "W"), help="pixels of photographs"
    )
    parser.add_argument("--fov", type=float, default=24.0, metavar="DEG", help="horizontal field of view; default: 24")
    parser.add_argument("--alone", action="store_true", help="nothing but the ball and the light")
    parser.add_argument("--shift", type=float, default=0.0, metavar="PIXELS", help="move each bracket by up to this")
    parser.add_argument("--samples", type=int, default=48, help="a pixel")
    parser.add_argument("--ball-samples", type=int, default=192, help="a pixel around the ball")
    parser.add_argument(
        "--ideal-size", type=int, default=64, help="pixels along a side of ideal observations and targets"
    )
    parser.add_argument("--target-samples", type=int, default=1024, help="a pixel of the targets, at first")
    parser.add_argument("--no-targets", action="store_true", help="only captures")
    parser.add_argument("--seed", type=int, default=0)
    return exit_status("make_captures", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
