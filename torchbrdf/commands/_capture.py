"""What is doubtful of a photograph or its light before anything is explained, for warnings and the report."""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

from torchbrdf.commands._sight import Sight
from torchbrdf.images import Window, read_metadata
from torchbrdf.light import LightProbe, clipped_share
from torchbrdf.photograph import Circle, Observation
from torchbrdf.report import Doubt

FOV_KEY = "mirrorBallFov"
"""The attribute of a probe that `torchbrdf probe` wrote which holds its camera's field of view, in degrees."""

MIRROR_KEY = "mirrorBallPhotographs"
"""The attribute with the `fingerprint_of` each photograph that it was made from, a space between them."""

REFLECTANCE_KEY = "mirrorBallReflectance"
"""The attribute with what its mirror ball reflects, or `NOT_GIVEN`."""
NOT_GIVEN = "not given"
"""The reflectance of a mirror ball of which nobody said it."""

REFLECTS_ALL = (
    "the mirror ball is taken to reflect all light, and polished chrome reflects 0.55 to 0.7 of it: the light then "
    "comes out too dim, and every BRDF too bright"
)

_CROPPED = 0.02
"""Of the radius: how far a ball's circle may be from the largest that a picture holds, which is cut to it."""


_NEGATIVE = 0.05
"""Of a photograph's root mean square: how much of it may be below zero without a word. Noise about black is less, and
so are colours of measured materials outside Rec. 709, at most 0.035 (docs/accuracy.md)."""


def doubts_of_sight(options: argparse.Namespace, sight: Sight, exposed: bool = False) -> list[Doubt]:
    """What is doubtful of `options.photo`, under `options.probe`: its units, its camera.

    exposed  an alignment looks for its exposure
    Raises ValueError where the probe was made from that very photograph.
    """
    _refuse_the_mirror(options)
    found = []
    if sight.photograph.full is not None and not exposed:
        found.append(
            Doubt(
                "no-unit",
                f"{options.photo}: its whole numbers are shares of the largest that the file can hold, in no unit of "
                "the probe's, so how much the BRDF reflects is known up to one factor; give the photograph in "
                "floating point, exposed and scaled as the probe is",
            )
        )
    found += _doubts_of_values(options.photo, sight.observation)
    if not exposed:
        found += _doubts_of_mirror(options)
    if isinstance(sight.silhouette, Circle):
        fov = _attribute_of(options.probe, FOV_KEY)
        if fov is not None or not _cut_to(sight.silhouette, sight.photograph.size):
            same = "" if fov is None else f"; the camera of its probe has one of {fov} degrees, --fov {fov}"
            found.append(
                Doubt(
                    "camera",
                    f"{options.photo}: neither --fov nor the file tells the camera's field of view, so the ball is "
                    "taken as seen from infinity and straight ahead, and the BRDF is off where the camera was near or "
                    f"the ball beside the middle; give that of the whole photograph{same}",
                )
            )
    return found


def fingerprint_of(photograph: Path) -> str:
    """sha256 of a file."""
    with open(photograph, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def doubts_of_light(probe: LightProbe, aligned: bool = False) -> list[Doubt]:
    """What is doubtful of a probe: how bright it is where it is clipped.

    aligned  an alignment looks for the radiance of its lamps
    """
    if share := clipped_share(probe.radiance, probe.solid_angles):
        text = (
            f"{probe.name}: {share:.1%} of the sphere has its largest value, {float(probe.radiance.max()):g}, and "
            "looks clipped, as in a panorama of 8 bits: what is brighter there is lost, and no BRDF is right without "
            "it; give a probe with shorter exposures"
        )
        return [Doubt("clipped-light", text)]
    if not aligned and probe.lamps is not None and probe.lamps.certain:
        text = f"{probe.name}: {probe.lamps.about}, its brightest, look clipped; --align finds their radiance"
        return [Doubt("clipped-light", text)]
    return []


def _doubts_of_values(photo: Path, observation: Observation) -> list[Doubt]:
    """Radiance below zero, after averages over the pixels of the view."""
    seen = observation.image[observation.mask.expand_as(observation.image)]
    share = float(seen.clamp_max(0).norm() / seen.norm())
    if not share > _NEGATIVE:
        return []
    text = (
        f"{photo}: {float((seen < 0).float().mean()):.0%} of what it shows of the shape is below zero, down to "
        f"{float(seen.min()):.2g} where the mean is {float(seen.mean()):.2g}, which no radiance is; see whether more "
        "was subtracted from it than its black level"
    )
    return [Doubt("negative", text)]


def _doubts_of_mirror(options: argparse.Namespace) -> list[Doubt]:
    """A mirror ball that is the probe, or of which `torchbrdf probe` made it, and nobody said what it reflects."""
    if options.probe_layout == "mirror_ball" and options.mirror_reflectance is None:
        cure = "give --mirror-reflectance R"
    elif _attribute_of(options.probe, REFLECTANCE_KEY) == NOT_GIVEN:
        cure = "make it again by `torchbrdf probe` with --mirror-reflectance R or --metal NAME"
    else:
        return []
    return [Doubt("reflectance", f"{options.probe}: {REFLECTS_ALL}; {cure}")]


def _refuse_the_mirror(options: argparse.Namespace) -> None:
    known = _attribute_of(options.probe, MIRROR_KEY)
    if known is not None and fingerprint_of(options.photo) in known.split():
        raise ValueError(
            f"{options.photo}: this is the very photograph that the probe {options.probe} was made from, and it shows "
            "the mirror ball; give that of the ball of the material"
        )


def _attribute_of(probe: str, key: str) -> str | None:
    """What the file of a probe that `torchbrdf probe` wrote says of its mirror ball; None of others."""
    path = Path(probe)
    return read_metadata(path).get(key) if path.suffix.lower() == ".exr" and path.is_file() else None


def _cut_to(circle: Circle, size: tuple[int, int]) -> bool:
    """Whether a picture of so many rows and columns is a crop to the ball, of which no camera is told."""
    height, width = size
    whole = Circle.inscribed(Window(0, 0, width, height))
    return height == width and whole.differs(circle) <= max(1.0, _CROPPED * circle.radius)
