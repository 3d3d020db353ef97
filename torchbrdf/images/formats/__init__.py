"""Containers of pictures, one a file: its `SUFFIXES`, and `read(path)` to what is stored there.

In: a file that is there. Out: `Stored`: values as the format's own text defines them, what the file says of their
colour space and encoding, which pixels it recorded. Nothing is converted here.

To add a container, add a file here.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
