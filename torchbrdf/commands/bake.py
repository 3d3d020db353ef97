"""`torchbrdf bake`: basis images by Mitsuba, for many photographs under one light."""

import argparse
from pathlib import Path

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import (
    add_library,
    add_light,
    add_output,
    add_samples,
    add_shape,
    add_size,
    whole_number,
)
from torchbrdf.files import writing
from torchbrdf.transport import DEFAULT_SAMPLES

STATE_SUFFIX = ".unfinished"

EXAMPLES = (
    "torchbrdf bake --probe probe.exr --view shape.ply --width 0.3 -o basis.safetensors",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is rendered, and how well."""
    add_light(parser)
    add_shape(parser)
    add_library(parser)
    add_size(parser, 64, "pixels along a side; default: %(default)s")
    add_samples(parser, DEFAULT_SAMPLES, "samples a pixel")
    parser.add_argument("--seed", type=whole_number(0, 2**31 - 1), default=0, help="of the random numbers; default: 0")
    add_output(parser, "basis images, .safetensors")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Render all basis images with Mitsuba and store them, for `torchbrdf fit --basis`.

    Ctrl-C keeps what is done in FILE.unfinished; the same command goes on from there.
    """
    from torchbrdf.commands._inputs import open_library, open_probe, open_view
    from torchbrdf.mitsuba_backend import bake_basis

    state = Path(f"{options.output}{STATE_SUFFIX}")
    with writing(options.output) as temporary:
        probe = open_probe(options)
        view = open_view(options, options.size)
        library = open_library(options)
        try:
            basis = bake_basis(library, probe, view, options.samples, options.seed, progress=True, state=state)
        except KeyboardInterrupt:
            if state.exists():
                raise KeyboardInterrupt(f"interrupted; what is done is in {state}: the same command goes on") from None
            raise
        basis.save(temporary)
    state.unlink(missing_ok=True)
    if basis.relative_errors is not None:
        median, worst = basis.relative_errors.median(), basis.relative_errors.max()
        findings.line(f"estimated error of the {basis.n} images: median {median:.2%}, worst {worst:.2%}")
        findings.add(estimated_error={"median": median, "worst": worst})
    findings.line(f"wrote {options.output}: {basis}")
    findings.add(images=basis.n)
    findings.add_files(options.output)
    return 0
