"""Priors of the weights, and how well each explains a photograph [CBP21, eqs. 23-26; Mac92].

In: material classes, norms of basis BRDFs, the space of basis images. Out: a `PriorBank`, which weighs all priors and
penalties by their evidence.

To add a prior, add a file here that gives its variances S, and their place to `prior_variances`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
