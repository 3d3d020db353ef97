"""`torchbrdf observe`: what a light and a view will tell, before the photograph."""

import argparse
from pathlib import Path

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_library, add_light, add_shape, add_size
from torchbrdf.progress import progress_bar, told_if_slow

_SIZE = 64
_SHOWN = 5
_SAMPLES = 512
"""A pixel, of images for the rehearsal alone, where no transport is prepared: the 4096 of others take four times as
long and change its error by 1.5 % of itself."""
_SLOW = "; after `torchbrdf precompute` that takes a second each"

EXAMPLES = (
    "torchbrdf observe --probe probe.exr",
    "torchbrdf observe --probe probe.exr --suggest --probes window.exr lamp.exr",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which light and view, and what could be added."""
    add_light(parser)
    add_shape(parser)
    add_size(parser, _SIZE, "pixels along a side of the photograph's object; default: %(default)s")
    add_library(parser)
    text = "also say by which second photograph or lamp the error would fall most"
    parser.add_argument("--suggest", action="store_true", help=text)
    text = "with --suggest: other light probes to choose the second photograph's from, read as --probe is"
    parser.add_argument("--probes", nargs="+", default=[], type=Path, metavar="FILE", help=text)


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Say what photographs under a light will tell of a material, and how far off it will be under other light.

    The library's own materials are photographed under the light by its basis images, recovered each from the others,
    and shown under other light: the probe from three other sides, and the embedded one. With --suggest, so are they
    with a second photograph, the camera gone round the ball or under another probe, or with a lamp added.
    """
    from torchbrdf.commands._inputs import open_library, open_probe, open_view
    from torchbrdf.commands._suggestions import suggestions
    from torchbrdf.estimation import BRDFEstimator, MaterialClasses
    from torchbrdf.light import LightProbe, other_lights
    from torchbrdf.rendering import render_basis
    from torchbrdf.transport import BasisImages
    from torchbrdf.transport.harmonic import in_perspective, is_precomputed, unsuited

    if options.probes and not options.suggest:
        raise ValueError("--probes names lights to choose from: give --suggest, too")
    probe = open_probe(options)
    given = vars(options)
    others = {str(path): open_probe(argparse.Namespace(**given | {"probe": str(path)})) for path in options.probes}
    view, library = open_view(options, options.size), open_library(options)
    classes = MaterialClasses.fit(library)
    fast = unsuited(view) is None and is_precomputed(library, in_perspective(view))

    def rendered(light: LightProbe) -> BasisImages:
        return render_basis(library, light, view, samples=None if fast else _SAMPLES)

    with told_if_slow(f"rendering the library under this light and others{'' if fast else _SLOW}"):
        basis = render_basis(library, probe, view, progress=True)
        novel = [rendered(light) for light in progress_bar(other_lights(probe), desc="other lights")]
    with told_if_slow("rehearsing: every material of the library is photographed and recovered from the others"):
        found = BRDFEstimator(basis, classes).observability(library, novel)
    assert found.rehearsal is not None
    expected = found.rehearsal.error
    told = suggestions(others, rendered, classes, view, probe, basis, novel, expected) if options.suggest else []
    findings.line(found.verdict)
    if told:
        findings.line("what would take most of that error off, as rehearsed:")
    for one in told[:_SHOWN]:
        findings.line(f"  {one}")
    findings.add(
        predicted_error=expected,
        predicted_error_by_kind=found.rehearsal.by_kind,
        verdict=found.verdict,
        highlight=found.highlight,
        grazing=found.grazing,
        dark=found.dark,
        freedom=found.whole,
    )
    if options.suggest:
        listed = [{"what": one.what, "predicted_error": one.error, "before": one.before} for one in told]
        findings.add(suggestions=listed)
    return 0
