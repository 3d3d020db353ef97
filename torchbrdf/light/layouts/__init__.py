"""How a picture of light may be laid out, other than lat-long: one layout a file, named after it, with its `LAYOUT`.

In: a picture, and where in it the sphere is. Out: the lat-long map, and the solid angles of the pixels.

To add a layout, add a file here, and its name to `Layout` in `light/settings.py`, from which type checkers know it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
