"""`torchbrdf probe`: from photographs of a mirror ball to a light probe."""

import argparse
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import LARGEST_SIZE, add_camera, add_output, add_strict, number, whole_number
from torchbrdf.files import writing
from torchbrdf.images import DEFAULT_SPACE, ColourSpace
from torchbrdf.progress import told_if_slow

if TYPE_CHECKING:
    from torchbrdf.light.mirror import Metal, MirrorPhotograph, MirrorProbe

_MUCH_SPHERE, _MUCH_LIGHT = 0.1, 0.05
"""Shares that are filled in: above one of them the command warns."""

_MUCH_WHITE = 0.002
"""Share of a ball's pixels at the largest value, above which the command warns."""

_LEAST_METAL = 0.25
"""Reflectance at normal incidence below which the command warns: chromium has 0.55, magnesia 0.07."""

_ANOTHER_SIDE = 20.0
"""Degrees between two cameras, below which the second shows little more than the first."""

EXAMPLES = (
    "torchbrdf probe mirror.exr --fov 24 --metal Cr -o probe.exr",
    "torchbrdf probe front.exr side.exr --focal-mm 85 --sensor-mm 36 --mirror-reflectance 0.6 -o probe.exr",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which photographs, by which camera, of which ball."""
    text = "linear HDR photograph of the mirror ball; a second, by the same camera from another side, shows the rest"
    parser.add_argument("photos", type=Path, nargs="+", metavar="PHOTO", help=text)
    text = "horizontal field of view of the whole photograph, as given"
    parser.add_argument("--fov", type=number(0, 180), metavar="DEG", help=text)
    add_camera(parser)
    group = parser.add_argument_group("the ball", "once for each photograph, in their order")
    text = "silhouette in pixels; default: from the mask, else found in the photograph"
    three = ("X", "Y", "R")
    group.add_argument("--circle", type=number(), nargs=3, metavar=three, action="append", default=[], help=text)
    text = "image that is white where the ball may be used"
    group.add_argument("--mask", type=Path, metavar="FILE", action="append", default=[], help=text)
    text = "which of the balls found, from 1, the largest; default: the largest, unless another is almost as large"
    group.add_argument("--ball", type=whole_number(1), metavar="N", action="append", default=[], help=text)
    group = parser.add_argument_group("what the ball reflects", "default: all light, with a warning")
    text = "share of the light, one number or R G B"
    group.add_argument("--mirror-reflectance", type=number(0), nargs="+", metavar="R", help=text)
    text = "polished metal by Mitsuba's name, such as Ag, Al, Cr or Ni_palik: Fresnel's reflectance"
    group.add_argument("--metal", metavar="NAME", help=text)
    text = "take nothing from the photograph's parts beside the ball, whatever it does not show itself"
    parser.add_argument("--no-surroundings", action="store_true", help=text)
    text = "of the probe; default: as fine as the middle of the ball, at least 512"
    parser.add_argument("--rows", type=whole_number(8, LARGEST_SIZE), metavar="N", help=text)
    parser.add_argument("--layer", metavar="NAME", help="of photographs that hold several pictures")
    text = (
        "take photographs of 8 or 16 bits, decoded as they say, else with sRGB (JPEG) or gamma 2.2; lamps are clipped "
        "there"
    )
    parser.add_argument("--allow-ldr", action="store_true", help=text)
    text = "linear RGB of the probe, to which photographs are converted; default: %(default)s"
    parser.add_argument("--primaries", choices=get_args(ColourSpace), default=DEFAULT_SPACE, help=text)
    add_strict(parser)
    add_output(parser, "the light probe, lat-long, .exr")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Unwrap a photograph of a mirror ball, or two, into a lat-long light probe in the frame of the first camera."""
    from torchbrdf.commands._capture import FOV_KEY, MIRROR_KEY, NOT_GIVEN, REFLECTANCE_KEY, fingerprint_of
    from torchbrdf.light import LightProbe
    from torchbrdf.light.mirror import unwrapped

    check_options(options)
    reflectance, reflects = _reflectance(options)
    read = (_photograph(options, index, reflectance) for index in range(len(options.photos)))
    photographs, sights = zip(*read, strict=True)
    title = " and ".join(path.name for path in options.photos)
    with told_if_slow(f"unwrapping {title}"):
        found = unwrapped(photographs, reflectance, options.rows, beside=not options.no_surroundings)
    probe = LightProbe(found.radiance, unknown_lamps=True, name=f"light of {title}")
    with writing(options.output) as temporary:
        about = {
            "mirrorBall": "; ".join((*sights, reflects, *_told(found))),
            FOV_KEY: f"{photographs[0].ball.camera.fov_deg:.4g}",
            MIRROR_KEY: " ".join(map(fingerprint_of, options.photos)),
            REFLECTANCE_KEY: reflects if _tells_reflectance(options) else NOT_GIVEN,
        }
        probe.save(temporary, options.primaries, about)
    for line in (*sights, reflects, *_told(found)):
        findings.line(line)
    for warning in _doubts(options, found):
        warnings.warn(warning, UserWarning, stacklevel=2)
    findings.line(f"wrote {options.output}")
    kinds = {"reflected": found.reflected, "beside": found.beside, "filled": found.filled}
    findings.add(
        about=[*sights, reflects, *_told(found)],
        size=found.reflected.shape,
        share_of_sphere={kind: found.share(where) for kind, where in kinds.items()},
        share_of_light={kind: found.light(where) for kind, where in kinds.items()},
        turn_degrees=None if found.turn is None else found.turn.degrees,
        gain=None if found.turn is None else found.turn.gain,
    )
    findings.add_files(options.output)
    return 0


def check_options(options: argparse.Namespace) -> None:
    """Raise ValueError for options that do not go together."""
    count = len(options.photos)
    if count > 2:
        raise ValueError(f"a mirror ball is unwrapped from one or two photographs, got {count}")
    for name in ("circle", "mask", "ball"):
        given = len(getattr(options, name))
        if given not in (0, count):
            raise ValueError(f"--{name} is given once for each photograph, in their order: {count}, got {given}")
    if options.metal is not None and options.mirror_reflectance is not None:
        raise ValueError("--metal and --mirror-reflectance say the same: give one of them")
    if options.metal is not None and options.primaries != DEFAULT_SPACE:
        raise ValueError(f"--metal is known in {DEFAULT_SPACE} alone, got --primaries {options.primaries}")
    if options.output.suffix.lower() != ".exr":
        raise ValueError(f"{options.output}: a light probe is saved as .exr; name it .exr")


def _reflectance(options: argparse.Namespace) -> "tuple[list[float] | Metal, str]":
    """What the ball reflects, and in words."""
    import torch

    from torchbrdf.light import checked_reflectance
    from torchbrdf.light.mirror import Metal

    if options.metal is not None:
        metal = Metal.open(options.metal)
        if float(metal.reflectance(torch.zeros(())).max()) < _LEAST_METAL:
            warnings.warn(f"--metal {metal}: is hardly a metal; is the ball of it?", UserWarning, stacklevel=2)
        return metal, f"the ball is of {metal}"
    factors = checked_reflectance(options.mirror_reflectance or 1.0)
    return factors, f"the ball reflects {' '.join(f'{factor:g}' for factor in factors)} of the light"


def _tells_reflectance(options: argparse.Namespace) -> bool:
    return options.metal is not None or options.mirror_reflectance is not None


def _photograph(
    options: argparse.Namespace, index: int, reflectance: "list[float] | Metal"
) -> "tuple[MirrorPhotograph, str]":
    """One of them with its ball, and how that was found."""
    from torchbrdf.camera import Ball
    from torchbrdf.commands._inputs import about, open_camera
    from torchbrdf.commands._sight import find_silhouette
    from torchbrdf.light.mirror import MirrorPhotograph
    from torchbrdf.photograph import Photograph

    path = options.photos[index]
    circle, mask, ball_number = (
        given[index] if given else None for given in (options.circle, options.mask, options.ball)
    )
    photograph = Photograph.open(
        path, mask, allow_ldr=options.allow_ldr, layer=options.layer, primaries=options.primaries
    )
    camera, told = open_camera(options, path, photograph.size)
    if camera is None:
        raise ValueError(
            f"{path}: the camera's field of view is needed, and the file does not tell it: give --fov DEG, across the "
            "width of this picture, or --focal-mm MM with --sensor-mm MM; of a crop, --fov of what was kept, and "
            "--principal X Y, where the whole picture's middle lies in it; for a ball seen from very far away, or "
            "without perspective, --fov 1"
        )
    one = argparse.Namespace(photo=path, circle=circle, mask=mask, ball=ball_number)
    with about(path):
        ball, origin = find_silhouette(one, photograph, camera)
        if not isinstance(ball, Ball):
            raise ValueError("the ball needs its camera")
        marked = None if photograph.mask is None else photograph.mask[0]  # NaN pixels count: they are told
        recorded = MirrorPhotograph(photograph.image, ball, marked)
        found = recorded.with_lamps_lost()
    for doubt in _doubts_of(recorded, found, reflectance):
        warnings.warn(f"{path}: {doubt}", UserWarning, stacklevel=2)
    read = f" ({'; '.join(photograph.about)})" if photograph.about else ""
    return found, f"{path}{read}: {ball}, {origin}, {ball.beside}, {told}"


def _doubts_of(
    recorded: "MirrorPhotograph", found: "MirrorPhotograph", reflectance: "list[float] | Metal"
) -> list[str]:
    """What a photograph does not hold: as it was recorded, and with lamps marked."""
    from torchbrdf.light.mirror import Metal, looks_matte

    doubts = []
    factors = 1.0 if isinstance(reflectance, Metal) else found.image.new_tensor(reflectance)[:, None, None]
    if looks_matte(found.bounded / factors, found.shown & found.sound, found.ball):
        doubts.append(
            "the ball looks matte: it shows nothing as sharp as a mirror does, nor what lies beside it, so what is "
            "written is no light that a BRDF could be found under; give the photograph of the mirror ball"
        )
    if found is not recorded:
        doubts.append(f"{found.lost} pixels of the ball have its largest value and are clipped: taken as infinite")
    elif found.white > _MUCH_WHITE:
        doubts.append(
            f"{found.white:.1%} of the ball's pixels have its largest value, and look clipped: too many to be a lamp "
            "whose radiance --align could find, and the light comes out too dim; add shorter exposures"
        )
    if found.empty:
        lost = "" if found.lost else "; a lamp among them would be lost"
        doubts.append(f"{found.empty} pixels of the ball hold no radiance (NaN) and are filled from around them{lost}")
    return doubts


def _told(found: "MirrorProbe") -> list[str]:
    """What came out, in words."""
    height, width = found.reflected.shape
    lines = [] if found.turn is None else [str(found.turn)]
    return [
        *lines,
        f"light of {height} x {width} texels: {found.share(found.reflected):.1%} of the sphere seen in the ball, "
        f"{found.share(found.beside):.1%} beside it, and {found.share(found.filled):.1%}, behind it, filled from "
        f"around with {found.light(found.filled):.1%} of the light",
    ]


def _doubts(options: argparse.Namespace, found: "MirrorProbe") -> list[str]:
    """What may be wrong with it."""
    import torch

    from torchbrdf.commands._capture import REFLECTS_ALL

    doubts = []
    if not _tells_reflectance(options):
        doubts.append(f"{REFLECTS_ALL}; give --mirror-reflectance R or --metal NAME")
    infinite = torch.isposinf(found.radiance).any(0)
    if bool(infinite.any()):
        doubts.append(
            f"{int(infinite.sum())} texels of the light, {found.share(infinite):.2%} of the sphere, are infinite: a "
            "lamp too bright for every exposure. `torchbrdf fit --align` finds its radiance by what it lights (one for "
            "all of them), and without --align fit refuses them; a shorter exposure shows it"
        )
    sphere, light = found.share(found.filled), found.light(found.filled)
    if sphere > _MUCH_SPHERE or light > _MUCH_LIGHT:
        cure = "a second photograph from another side" if found.turn is None else "one from a more different side"
        doubts.append(
            f"{sphere:.1%} of the sphere with {light:.1%} of the light are a guess, continued from around; {cure}, or "
            "a larger picture of the ball, shows more"
        )
    if found.turn is not None and found.turn.degrees < _ANOTHER_SIDE:
        doubts.append(
            f"both photographs are from nearly the same side ({found.turn.degrees:.1f} degrees apart) and hide the "
            "same; move the camera by 60 to 120 degrees around the ball"
        )
    if found.turn is not None and found.turn.gain != 1:
        doubts.append(
            f"the second photograph is {found.turn.gain:.3g} times as bright as the first, to which it was scaled; the "
            "exposures differ, or the light changed"
        )
    return doubts
