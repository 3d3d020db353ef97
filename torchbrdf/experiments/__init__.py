"""What accuracy is measured with: targets by another renderer, errors under new light, resumable sweeps, tables.

In: targets, probes, libraries, settings of the estimator. Out: cases, rows and tables of Markdown. The scripts beside
the package measure with it; so can anyone who compares a method of their own.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
