"""The camera of a whole photograph, and how it sees a ball: a cone, whose outline is an ellipse [CBP21, sec. IV].

In: a field of view, a focal length, coefficients of a lens. Out: a `PinholeCamera`, from directions to pixels and back,
and a `Ball` anywhere in its frame.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
