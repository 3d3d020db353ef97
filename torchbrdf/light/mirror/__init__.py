"""The light from photographs of mirror balls by a pinhole camera, anywhere in its frame.

In: a linear photograph, the `Ball` in it, what it reflects. Out: a lat-long map in the camera's frame, what of it was
seen, and what was filled.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
