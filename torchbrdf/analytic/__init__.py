"""Analytic BRDFs fitted to tables and to photographs, from the start that a reconstruction gives.

In: a `MerlTable`, a `Reconstruction`, or a photograph under a known light. Out: an `AnalyticFit`: parameters of one of
the `models`, for other programs in `export`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
