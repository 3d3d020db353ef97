"""Brackets of exposures to one linear picture of radiance.

In: files of one scene at several exposures. Out: `Merged`: radiance over exposure (time, speed and aperture), NaN where
no exposure holds it, and what was found: the camera's response, how the camera moved, which times it keeps.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
