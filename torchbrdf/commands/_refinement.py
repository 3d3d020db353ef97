"""`torchbrdf analytic --photograph`: the parameters go on from the fit of a table on the photograph itself."""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from torchbrdf.analytic import AnalyticFit, CellTransport, fit_analytic_to_image, image_error
from torchbrdf.commands._capture import doubts_of_light, doubts_of_sight
from torchbrdf.commands._inputs import about
from torchbrdf.commands._options import add_photographed
from torchbrdf.commands._said import say_doubts
from torchbrdf.commands._sight import Sight, read_observation
from torchbrdf.light import LightProbe
from torchbrdf.progress import told_if_slow


def check_pair(options: argparse.Namespace) -> None:
    """Raise ValueError for a photograph without its light, and for what belongs to one where none is given."""
    if options.photograph is not None:
        if options.probe is None:
            raise ValueError("--photograph needs the light that it was taken under: give --probe, too")
        return
    if options.probe is not None and options.preview is None:
        raise ValueError("--probe is the light of --photograph or of --preview: give one of them, too, or leave it out")
    nothing_said = argparse.ArgumentParser()
    add_photographed(nothing_said)
    for name, default in vars(nothing_said.parse_args([])).items():
        if getattr(options, name) != default:
            raise ValueError(f"--{name.replace('_', '-')} is of a photograph: give --photograph, too")


@dataclass(frozen=True, eq=False)
class Refinement:
    """A photograph, and how a BRDF becomes its pixels."""

    path: Path
    sight: Sight
    probe: LightProbe
    transport: CellTransport

    @classmethod
    def of(cls, options: argparse.Namespace, probe: LightProbe) -> "Refinement":
        """Of `options.photograph`, found in its frame as `fit` finds it, at its own size, at most 128."""
        options = argparse.Namespace(**vars(options) | {"photo": options.photograph})
        sight = read_observation(options, None)
        say_doubts([*doubts_of_sight(options, sight), *doubts_of_light(probe)])
        with told_if_slow(f"sampling the light that every pixel of {options.photo} shows, once for all fits"):
            transport = CellTransport.build(probe, sight.view)
        return cls(options.photo, sight, probe, transport)

    def error(self, fit: AnalyticFit) -> float:
        """How far a fit's pixels are from the photograph's, as those of a refined one."""
        observation = self.sight.observation
        return image_error(fit, observation.image, self.transport, observation.mask)

    def refined(self, start: AnalyticFit, most_evaluations: int | None) -> AnalyticFit:
        """The fit that explains the photograph best, in the model of its start."""
        observation = self.sight.observation
        with about(self.path):
            found = fit_analytic_to_image(
                observation.image,
                self.probe,
                self.sight.view,
                start.model,
                mask=observation.mask,
                start=start,
                shared=start.shared,
                most_evaluations=most_evaluations,
                transport=self.transport,
            )
        return replace(found, name=self.path.name)
