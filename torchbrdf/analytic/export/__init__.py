"""Analytic BRDFs as materials of other programs: Mitsuba 3, glTF 2.0, MaterialX, OpenPBR, MERL tables.

In: an `AnalyticFit`. Out: a file. Where a program lacks the model, `native_fit` fits one that it has.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
