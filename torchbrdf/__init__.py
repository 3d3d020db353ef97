"""Measured-quality BRDFs from one photograph of a sphere under a known light probe."""

import os

import lazy_loader

from torchbrdf._version import __version__ as __version__

# libgomp reads it when torch is first imported. Idle threads of torch spin for long by default and take the cores
# from Mitsuba's threads and from other processes: basis images on two busy cores took 30 s and more instead of 7 s.
# Spinning shortly costs nothing on quiet ones (docs/mitsuba.md).
os.environ.setdefault("GOMP_SPINCOUNT", "5000")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
