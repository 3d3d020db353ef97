"""From a photograph to an observation: where the ball is, and the means over the pixels of a view.

In: a linear picture, a mask, a silhouette. Out: an `Observation`, whose pixels mean what those of basis images do.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
