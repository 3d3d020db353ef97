"""What is wrong with arguments of a public call before they are used: their types, or gradients that would be lost.

In: what users gave. Out: one clear line, as an error or a warning on behalf of their line.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
