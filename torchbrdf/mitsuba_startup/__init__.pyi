from .loading import (
    FAST_VARIANT as FAST_VARIANT,
    LLVM_PACKAGE as LLVM_PACKAGE,
    LLVM_VARIABLE as LLVM_VARIABLE,
    OLDEST_LLVM as OLDEST_LLVM,
    SLOW_VARIANT as SLOW_VARIANT,
    MitsubaUnavailableError as MitsubaUnavailableError,
    is_vectorised as is_vectorised,
    load_mitsuba as load_mitsuba,
    mitsuba_program as mitsuba_program,
    packaged_llvm as packaged_llvm,
)
from .trial import (
    DRJIT_CACHE_VARIABLE as DRJIT_CACHE_VARIABLE,
    Trial as Trial,
    try_render as try_render,
)
