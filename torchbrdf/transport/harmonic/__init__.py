"""Transport as rotations: on a sphere each ring of equal view angle is a convolution in azimuth.

In: a library, whose side of the transport is computed once and kept on disk; then a probe, in any orientation, and a
view of an orthographic camera, or of a ball in perspective. Out: basis images in a tenth of a second.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
