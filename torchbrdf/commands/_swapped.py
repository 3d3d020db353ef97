"""A photograph and a probe that were given in each other's place."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torchbrdf.images import read_picture


@contextmanager
def telling_swapped(photograph: Path, options: argparse.Namespace) -> Iterator[None]:
    """In the block a ValueError about a photograph, or its probe, says so where each looks like the other's file."""
    try:
        yield
    except ValueError:
        if options.probe in (None, "default") or options.probe_layout != "latlong":
            raise
        shown, light = _size(photograph, options.layer), _size(Path(options.probe), options.probe_layer)
        if not (_is_panorama(shown) and light is not None and not _is_panorama(light)):
            raise
        raise ValueError(
            f"{photograph}: is twice as wide as high, as a light probe is, and that of --probe, {options.probe}, is "
            f"not ({light[0]} x {light[1]}): they look swapped; give the ball as the photograph, and the panorama to "
            "--probe. If they are not, say what the probe is: --probe-layout"
        ) from None


def _size(path: Path, layer: str | None) -> tuple[int, int] | None:
    """Height and width of a picture; None where it cannot be read."""
    try:
        image = read_picture(path, True, layer=layer).image
    except (ValueError, OSError):
        return None
    return image.shape[1], image.shape[2]


def _is_panorama(size: tuple[int, int] | None) -> bool:
    return size is not None and size[1] == 2 * size[0]
