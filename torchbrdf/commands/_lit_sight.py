"""A photograph with its light, both aligned where that is asked for: what an estimator needs to know of it."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from torchbrdf.brdf import MaterialLibrary
from torchbrdf.commands import _alignment
from torchbrdf.commands._capture import doubts_of_light, doubts_of_sight
from torchbrdf.commands._inputs import check_reading, open_library, open_probe
from torchbrdf.commands._reconstruction import Estimates
from torchbrdf.commands._said import say_doubts
from torchbrdf.commands._sight import read_observation
from torchbrdf.commands._swapped import telling_swapped
from torchbrdf.lasting import LastFew
from torchbrdf.light import LightProbe
from torchbrdf.photograph import Observation
from torchbrdf.report import Doubt, Scene
from torchbrdf.transport import BasisImages
from torchbrdf.view import View

if TYPE_CHECKING:  # a photograph that is not aligned need not wait for it
    from torchbrdf.alignment import Alignment

_PROBES = 4
"""Kept open for the next photographs."""


@dataclass(frozen=True, eq=False)
class LitSight:
    """What is seen, and under which light.

    observation  divided by its exposure where that was found
    about, light  for people: the photograph, and the probe as it was before an alignment
    basis        where the alignment rendered it, or a file holds it
    found        by the alignment; None where none is asked for
    scene        for the report; None where none is asked for: it holds the whole photograph
    doubts       about the capture, which were said
    """

    observation: Observation
    view: View
    about: str
    probe: LightProbe
    light: str
    basis: BasisImages | None
    found: Alignment | None
    scene: Scene | None
    doubts: tuple[Doubt, ...]

    def settings(self, options: argparse.Namespace) -> dict[str, str]:
        """For the report."""
        settings = {
            "title": options.photo.name,
            "photograph": self.about,
            "light probe": self.light,
            "colours": f"linear {options.primaries}",
        }
        return settings if self.found is None else settings | {"alignment": str(self.found)}


class Inputs:
    """What photographs share: the library with its estimates, and the last few probes."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Nothing is opened yet."""
        self._options = options
        self._probes: LastFew[str, tuple[LightProbe, list[Doubt]]] = LastFew(_PROBES)

    @cached_property
    def library(self) -> MaterialLibrary:
        """Of `--library`."""
        return open_library(self._options)

    @cached_property
    def estimates(self) -> Estimates:
        """By this library."""
        options = self._options
        return Estimates(self.library, options.penalty, options.constraint, options.robust)

    def probe(self, given: str) -> tuple[LightProbe, list[Doubt]]:
        """A probe as `--probe` takes it, and what is doubtful of it, which is said when it is opened."""

        def opened() -> tuple[LightProbe, list[Doubt]]:
            probe = open_probe(argparse.Namespace(**vars(self._options) | {"probe": given}))
            doubts = doubts_of_light(probe, self._options.align)
            say_doubts(doubts)
            return probe, doubts

        return self._probes.get_or_make(given, opened)


def lit_sight(options: argparse.Namespace, inputs: Inputs) -> LitSight:
    """The photograph of `options.photo` under `options.probe`; says what there is to say of an alignment."""
    check_reading(options)
    size = options.size
    if options.basis is not None and size is None:
        size = BasisImages.load(options.basis).size[1]
    with telling_swapped(options.photo, options):
        sight = read_observation(options, size)  # first: the library may take long to open
        doubts = doubts_of_sight(options, sight, options.exposure or options.white_balance)
        say_doubts(doubts)
        probe, of_light = inputs.probe(options.probe)
    found = None
    light = ", ".join(filter(None, (probe.name.removeprefix("light probe "), probe.reading)))
    basis = None if options.basis is None else BasisImages.load(options.basis, inputs.library, probe, sight.view)
    observation = sight.observation
    if options.align:
        found = _alignment.aligned(options, sight, probe, inputs.library)
        _alignment.warn_of_lamps(probe, found)
        _alignment.warn_of_turn(found)
        _alignment.warn_of_blur(found)
        sight, probe, basis = _alignment.seen_anew(sight, found), found.probe, _alignment.basis_of(found)
        observation = _alignment.divided(sight.observation, found)
    scene = None if options.no_report else sight.scene
    return LitSight(observation, sight.view, sight.about, probe, light, basis, found, scene, (*doubts, *of_light))
