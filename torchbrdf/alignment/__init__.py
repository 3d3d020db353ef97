"""How a probe must be turned to explain a photograph: the search that [CBP21, table I] asks for.

In: a photograph, a probe, a view, a library. Out: an `Alignment`: the rotation, what it leaves open, and basis images
under the turned light.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
