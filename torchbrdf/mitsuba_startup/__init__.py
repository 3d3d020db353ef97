"""Mitsuba 3, loaded so that it works or says in one sentence why not.

In: nothing but what is installed. Out: the `mitsuba` module in a variant that can be evaluated, or
`MitsubaUnavailableError`. It is imported when something first needs it, and only by way of here.
"""

from torchbrdf.mitsuba_startup.loading import (
    FAST_VARIANT,
    LLVM_PACKAGE,
    LLVM_VARIABLE,
    OLDEST_LLVM,
    SLOW_VARIANT,
    MitsubaUnavailableError,
    is_vectorised,
    load_mitsuba,
    packaged_llvm,
)
from torchbrdf.mitsuba_startup.trial import DRJIT_CACHE_VARIABLE, Trial, try_render

__all__ = [
    "DRJIT_CACHE_VARIABLE",
    "FAST_VARIANT",
    "LLVM_PACKAGE",
    "LLVM_VARIABLE",
    "OLDEST_LLVM",
    "SLOW_VARIANT",
    "MitsubaUnavailableError",
    "Trial",
    "is_vectorised",
    "load_mitsuba",
    "packaged_llvm",
    "try_render",
]
