"""From a photograph to weights of basis BRDFs [CBP21, secs. V and VI].

In: basis images Y, material classes, a photograph y. Out: a `Reconstruction`: weights w with rho = B w, the class,
errors, and the posterior: the average over priors, or one class's solution [CBP21, eq. 26], within constraints.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
