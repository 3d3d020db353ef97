"""Pictures of BRDFs: one table, or all columns of a library, under a probe or a directional light [CBP21, eq. 1].

In: tables or a library, a probe, a view. Out: radiance `(3, H, W)`, or `BasisImages` by the backend that suits the
view.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
