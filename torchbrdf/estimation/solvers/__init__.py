"""Linear solves: ridge regression with cached factors [CBP21, eqs. 25-26], and quadratic programs.

In: basis images or a precision matrix, a right-hand side, a prior. Out: weights. One method is one file; a new solver
comes beside them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
