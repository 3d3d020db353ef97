"""Mitsuba 3 beside the transport of this package: it bakes basis images, judges ours and shows results.

In: tables, libraries, probes, views. Out: renderings with error estimates, `BasisImages`, scenes on disk, and `merl`, a
BSDF plugin for any Mitsuba scene.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
