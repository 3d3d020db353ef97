"""Sweeps: many independent tasks, on this machine or on a Dask cluster, each finished one kept in a file of its own.

In: a pure function of an importable module, and tasks with arguments that JSON holds. Out: their results, which JSON
holds, too. Every task computes with one torch thread, wherever it runs: sums are then done in one order, so a sweep
gives the same bits in this process, in several and on a cluster of like machines, and several processes use the cores
better than several threads.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
