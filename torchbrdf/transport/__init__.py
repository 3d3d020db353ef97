"""Light transport: pixels as weighted cells of the BRDF, which basis images gather [CBP21, eq. 5].

In: columns of B, a probe, a view. Out: `BasisImages` and what they are made of, by samples here and by rotations in
`harmonic`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
