"""Which second photograph, or which lamp, would tell most: each is rehearsed."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos
from statistics import fmean

import torch

from torchbrdf.estimation import BRDFEstimator, MaterialClasses
from torchbrdf.light import LightProbe, directions_at, turned
from torchbrdf.progress import progress_bar
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
    lights: Mapping[str, LightProbe],
    rendered: Callable[[LightProbe], BasisImages],
    classes: MaterialClasses,
    view: View,
    probe: LightProbe,
    basis: BasisImages,
    novel: Sequence[BasisImages],
    expected: float,
) -> list[Suggestion]:
    """All of them, the one with the largest part of the error taken off first.

    lights    of a second photograph, by the words for them
    rendered  the library's basis images under a light
    basis     of the first photograph, under the probe
    novel     under other light
    expected  the error of the first photograph alone there
    """

    def added() -> Iterator[tuple[str, list[BasisImages], Sequence[BasisImages], float]]:
        """What is added, the photographs then, the lights under which errors count, and that of the first there."""
        if isinstance(view, SphereView):
            for angle in _TURNS:
                side = "left" if angle > 180 else "right" if angle < 180 else "back"
                what = f"second photograph, the camera {min(angle, 360 - angle)} degrees round to the {side}"
                yield what, [basis, rendered(turned(probe, -angle))], novel, expected
        images = list(others.values())
        judged = len(images) > _ENOUGH
        alone = BRDFEstimator(basis, classes).rehearse(images).errors.mean(0).tolist() if judged else []
        for i, (name, light) in enumerate(others.items()):
            what, bases = f"second photograph, under {name}", [basis, light]
            if judged:
                left = images[:i] + images[i + 1 :]
                yield f"{what}, judged by the other probes", bases, left, fmean(alone[:i] + alone[i + 1 :])
            else:
                yield what, bases, novel, expected
        for where, direction in _LAMPS.items():
            lit = rendered(_lamp(direction, probe))
            brighter = replace(basis, packed=basis.packed + lit.packed)
            yield f"a lamp {where}, as bright as all light", [brighter], novel, expected

    others = {name: rendered(light) for name, light in lights.items() if light.fingerprint != probe.fingerprint}
    count = len(_LAMPS) + len(others) + (len(_TURNS) if isinstance(view, SphereView) else 0)
    found = []
    for what, bases, judges, before in progress_bar(added(), desc="suggestions", total=count):
        found.append(Suggestion(what, BRDFEstimator(bases, classes).rehearse(judges).error, before))
    return sorted(found, key=lambda one: one.error / max(one.before, 1e-30))


def _lamp(direction: tuple[float, float, float], probe: LightProbe) -> LightProbe:
    """A round grey lamp of the probe's power."""
    toward = torch.nn.functional.normalize(torch.tensor(direction), dim=0)
    y, x = torch.meshgrid(torch.arange(_LAMP_HEIGHT), torch.arange(2 * _LAMP_HEIGHT), indexing="ij")
    lit = directions_at(x, y, _LAMP_HEIGHT, 2 * _LAMP_HEIGHT) @ toward > cos(_LAMP_RADIUS)
    lamp = LightProbe(lit.float().expand(3, -1, -1))
    return lamp.scaled(float(probe.total_power.mean() / lamp.total_power.mean()))
