"""BRDFs that were measured: tables on MERL's grid, and libraries of them as columns of B [CBP21, sec. III].

In: MERL `.binary` files, or the embedded parameters. Out: `MerlTable`, f_r in 1/sr over (theta_h, theta_d, phi_d), and
`MaterialLibrary`, the n = 3 m basis BRDFs, stored once and memory-mapped.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
