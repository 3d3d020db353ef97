"""Pictures: linear radiance in files and on screens, and how far one picture is from another.

In: files of the containers in `formats`. Out: `(3, H, W)` float32 tensors of linear RGB, rows from the top, masks
`(1, H, W)` bool, and files that are whole or absent.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
