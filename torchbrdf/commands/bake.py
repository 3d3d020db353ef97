"""`torchbrdf bake`: basis images by Mitsuba, for many photographs under one light."""

import argparse
from pathlib import Path

from torchbrdf.commands.inputs import open_library, open_probe, open_view
from torchbrdf.files import writing
from torchbrdf.mitsuba_backend.baking import bake_basis

STATE_SUFFIX = ".unfinished"


def run(options: argparse.Namespace) -> int:
    """Render all basis images with Mitsuba and store them, for `torchbrdf fit --basis`.

    Ctrl-C keeps what is done in FILE.unfinished; the same command goes on from there.
    """
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
        print(f"estimated error of the {basis.n} images: median {median:.2%}, worst {worst:.2%}")
    print(f"wrote {options.output}: {basis}")
    return 0
