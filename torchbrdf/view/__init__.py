"""Known shapes before a camera: normals, view directions, masks [CBP21, sec. IV].

In: a size, normals or a triangle mesh, and a camera. Out: a `View`, which answers at any point inside a pixel; images
packed over the pixels of its mask. A new shape is a subclass of `View` in a file of its own here.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
