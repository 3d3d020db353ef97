"""Which second photograph, or which lamp, would tell most: each is rehearsed."""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import cos

import torch
from torch import Tensor
from tqdm import tqdm

from torchbrdf.brdf import MaterialLibrary
from torchbrdf.commands._inputs import open_probe
from torchbrdf.estimation import BRDFEstimator, MaterialClasses
from torchbrdf.light import LightProbe, directions_at, row_solid_angles, turned
from torchbrdf.rendering import render_basis
from torchbrdf.transport import BasisImages
from torchbrdf.view import SphereView, View

_TURNS = range(45, 360, 45)
"""Degrees by which the camera goes round the ball."""

_LAMPS = {
    "beside the camera": (1.0, 1.0, 3.0),
    "on the left": (-3.0, 1.0, 1.0),
    "on the right": (3.0, 1.0, 1.0),
    "above": (0.0, 1.0, 0.2),
    "behind the object, to the left": (-1.0, 0.7, -1.5),
    "behind the object, to the right": (1.0, 0.7, -1.5),
}
_LAMP_HEIGHT, _LAMP_RADIUS = 128, 0.1
"""Rows of its probe, and radians from its middle to its edge."""

_ENOUGH = 3
"""Other lights of `--probes` by which those of the list are judged; where fewer are left, by those of the rehearsal."""


@dataclass(frozen=True)
class Suggestion:
    """What to add, the mean error to expect then, and without it; shares of the picture's radiance."""

    what: str
    error: float
    before: float

    def __str__(self) -> str:
        return f"{self.what}: {100 * self.error:.1f} % in the place of {100 * self.before:.1f}"


def suggestions(
    options: Namespace,
    library: MaterialLibrary,
    classes: MaterialClasses,
    view: View,
    probe: LightProbe,
    basis: BasisImages,
    novel: Sequence[BasisImages],
) -> list[Suggestion]:
    """All of them, the one with the largest part of the error taken off first.

    basis  of the first photograph, under the probe
    novel  under other light
    """

    def rendered(light: LightProbe) -> BasisImages:
        return render_basis(library, light, view)

    def error(bases: BasisImages | Sequence[BasisImages], lights: Sequence[BasisImages]) -> float:
        return BRDFEstimator(bases, classes).rehearse(lights).error

    def added() -> Iterator[tuple[str, list[BasisImages], Sequence[BasisImages]]]:
        """What is added, the photographs then, and the lights under which their error counts."""
        if isinstance(view, SphereView):
            for angle in _TURNS:
                side = "left" if angle > 180 else "right" if angle < 180 else "back"
                what = f"second photograph, the camera {min(angle, 360 - angle)} degrees round to the {side}"
                yield what, [basis, rendered(turned(probe, -angle))], novel
        for path, light in others.items():
            left = [images for other, images in others.items() if other != path]
            judges = ", judged by the other probes" if len(left) >= _ENOUGH else ""
            yield f"second photograph, under {path}{judges}", [basis, light], left if judges else novel
        for where, direction in _LAMPS.items():
            lit = rendered(_lamp(direction, probe))
            yield f"a lamp {where}, as bright as all light", [replace(basis, packed=basis.packed + lit.packed)], novel

    opened = {str(path): open_probe(Namespace(**vars(options) | {"probe": str(path)})) for path in options.probes}
    others = {path: rendered(light) for path, light in opened.items() if light.fingerprint != probe.fingerprint}
    count = len(_LAMPS) + len(others) + (len(_TURNS) if isinstance(view, SphereView) else 0)
    before: dict[tuple[int, ...], float] = {}
    found = []
    for what, bases, lights in tqdm(added(), desc="suggestions", total=count, leave=False):
        key = tuple(map(id, lights))
        if key not in before:
            before[key] = error(basis, lights)
        found.append(Suggestion(what, error(bases if len(bases) > 1 else bases[0], lights), before[key]))
    return sorted(found, key=lambda one: one.error / max(one.before, 1e-30))


def _lamp(direction: tuple[float, float, float], probe: LightProbe) -> LightProbe:
    """A round grey lamp of the probe's power."""
    toward = torch.nn.functional.normalize(torch.tensor(direction), dim=0)
    y, x = torch.meshgrid(torch.arange(_LAMP_HEIGHT), torch.arange(2 * _LAMP_HEIGHT), indexing="ij")
    lit = directions_at(x, y, _LAMP_HEIGHT, 2 * _LAMP_HEIGHT) @ toward > cos(_LAMP_RADIUS)
    radiance = lit.float().expand(3, -1, -1)
    return LightProbe(radiance * float(_power(probe.radiance) / _power(radiance)))


def _power(radiance: Tensor) -> Tensor:
    """Of a probe's texels (3, H, W), integrated over the sphere; mean over channels."""
    return (radiance.double().sum((0, 2)) @ row_solid_angles(*radiance.shape[1:])) / len(radiance)
