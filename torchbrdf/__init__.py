"""Measured-quality BRDFs from one photograph of a sphere under a known light probe."""

import os
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import lazy_loader

from torchbrdf._version import __version__ as __version__

# libgomp reads it when torch is first imported. Idle threads of torch spin for long by default and take the cores
# from Mitsuba's threads and from other processes: basis images on two busy cores took 30 s and more instead of 7 s.
# Spinning shortly costs nothing on quiet ones (docs/mitsuba.md).
os.environ.setdefault("GOMP_SPINCOUNT", "5000")

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """A public name, or a room: `tb.brdf` is there before anything of it was used."""
    if name not in __all__ and not name.startswith("_") and find_spec(f"{__name__}.{name}") is not None:
        return import_module(f"{__name__}.{name}")
    return _public(name)
