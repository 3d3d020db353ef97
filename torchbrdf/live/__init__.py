"""Recovered BRDFs under a light that is turned by hand, in the browser.

In: a reconstruction, a library, a probe. Out: a page on the loopback address, and its pictures as fast as a hand moves.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
