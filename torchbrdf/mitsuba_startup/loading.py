"""Loading Mitsuba so that it works, or says in one sentence why not.

Mitsuba's `llvm_ad_rgb` variant compiles its kernels with a libLLVM. Dr.Jit 1.5 takes the one that the variable
DRJIT_LIBLLVM_PATH names, else one that it finds on the system, and loads it as soon as `drjit` is imported. It
refuses versions below 15, aborts the whole process at the first evaluation with 15 and 16, and works from 19 on.
So the library is chosen before the import, and its version is checked before anything is evaluated.
"""

import importlib.metadata
import os
import shlex
import sys
import warnings
from functools import cache
from pathlib import Path
from types import ModuleType

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
LLVM_PACKAGE = "karellen-llvm-core"
OLDEST_LLVM = 19
FAST_VARIANT = "llvm_ad_rgb"
SLOW_VARIANT = "scalar_rgb"


class MitsubaUnavailableError(ImportError):
    """Mitsuba cannot be imported, or not in a variant that works here; the message says what to do."""


def load_mitsuba(variant: str | None = None) -> ModuleType:
    """The `mitsuba` module with a variant set that can be evaluated.

    variant  an RGB variant; None: the one that is set already, else `llvm_ad_rgb` where the LLVM can be used, else
             `scalar_rgb`, with a warning (once a process) that says why
    Sets DRJIT_LIBLLVM_PATH, unless it is set or Dr.Jit is loaded already, to the library of karellen-llvm-core.
    Raises MitsubaUnavailableError where Mitsuba cannot be imported, the variant (given, or set by the caller) is not
    an RGB one, is not in this Mitsuba, or is an LLVM one while the LLVM would abort the process.
    """
    mitsuba = import_mitsuba()
    if variant is None:
        variant = mitsuba.variant() or _best_variant()
    if not variant.endswith("_rgb"):
        raise MitsubaUnavailableError(
            f"Mitsuba's variant is to be {variant}, but torchbrdf works with linear RGB; "
            f'call mitsuba.set_variant("{FAST_VARIANT}") first'
        )
    if variant.startswith("llvm") and (problem := llvm_problem()) is not None:
        raise MitsubaUnavailableError(
            f'Mitsuba\'s variant {variant} cannot be used: {problem}, or call mitsuba.set_variant("{SLOW_VARIANT}")'
        )
    if mitsuba.variant() != variant:
        try:
            mitsuba.set_variant(variant)
        except ImportError as error:
            raise MitsubaUnavailableError(
                f"Mitsuba's variant {variant} cannot be used ({_one_line(error)}); "
                f'call mitsuba.set_variant("{SLOW_VARIANT}")'
            ) from None
    return mitsuba


def import_mitsuba() -> ModuleType:
    """The `mitsuba` module as it is, no variant set by us, with the LLVM of karellen-llvm-core where none is named.

    Raises MitsubaUnavailableError where it cannot be imported.
    """
    if not os.environ.get(LLVM_VARIABLE) and "drjit" not in sys.modules and (library := packaged_llvm()) is not None:
        os.environ[LLVM_VARIABLE] = str(library)
    try:
        import mitsuba
    except ModuleNotFoundError as error:
        raise MitsubaUnavailableError(
            f"Mitsuba cannot be imported ({_one_line(error)}); run `pip install mitsuba {LLVM_PACKAGE}`"
        ) from None
    except ImportError as error:
        raise MitsubaUnavailableError(
            f"Mitsuba cannot be imported ({_one_line(error)}); run `pip install --force-reinstall mitsuba drjit`"
        ) from None
    if not hasattr(mitsuba, "set_variant"):
        raise MitsubaUnavailableError(
            f"the module `mitsuba` of {list(getattr(mitsuba, '__path__', []))} is not Mitsuba 3; "
            f"run `pip install mitsuba {LLVM_PACKAGE}`, and rename a folder or file of your own with that name"
        )
    return mitsuba


def is_vectorised(mi: ModuleType) -> bool:
    """Whether the variant set works on arrays, not on one ray at a time."""
    return not mi.variant().startswith("scalar")


def packaged_llvm() -> Path | None:
    """The libLLVM that the package karellen-llvm-core brings; None where that is not installed."""
    try:
        files = importlib.metadata.files(LLVM_PACKAGE) or []
    except importlib.metadata.PackageNotFoundError:
        return None
    found = [Path(str(file.locate())).resolve() for file in files if file.name.startswith("libLLVM.")]
    return next((path for path in found if path.is_file()), None)


def mitsuba_program(scene: str | os.PathLike[str]) -> str:
    """The line for a shell that renders a file by Mitsuba's own program, whatever LLVM the system has.

    That program takes the system's, which may abort it, unless DRJIT_LIBLLVM_PATH names another.
    """
    packaged, path = packaged_llvm(), shlex.quote(os.fspath(scene))
    named = os.environ.get(LLVM_VARIABLE)
    if packaged is not None and named in (None, "", str(packaged)):
        return f"{LLVM_VARIABLE}={shlex.quote(str(packaged))} mitsuba {path}"
    return f"mitsuba {path}" if named else f"mitsuba -m {SLOW_VARIANT} {path}"


def llvm_problem() -> str | None:
    """Why the LLVM that Dr.Jit has loaded cannot be used, and what to do; None where it can. Evaluates nothing."""
    import drjit

    major = drjit.detail.llvm_version()[0]
    if major >= OLDEST_LLVM:
        return None
    chosen, packaged = os.environ.get(LLVM_VARIABLE), packaged_llvm()
    if chosen and packaged is not None and Path(chosen) == packaged:
        where, cure = f"in {packaged}", f"run `pip install --force-reinstall {LLVM_PACKAGE}`"
    elif chosen:
        where = f"at {LLVM_VARIABLE}={chosen}"
        cure = f"unset {LLVM_VARIABLE}" + ("" if packaged is not None else f" and run `pip install {LLVM_PACKAGE}`")
    elif packaged is not None:
        where = "where Dr.Jit looked, being imported before torchbrdf could choose"
        cure = f"set {LLVM_VARIABLE}={packaged} before Python starts"
    else:
        where, cure = "on this system", f"run `pip install {LLVM_PACKAGE}`"
    found = f"LLVM {major}" if major > 0 else "no usable LLVM"
    return f"there is {found} {where}, and Mitsuba needs version {OLDEST_LLVM} or newer; {cure}"


@cache
def _best_variant() -> str:
    problem = llvm_problem()
    if problem is None:
        return FAST_VARIANT
    warnings.warn(f"Mitsuba runs in its slow variant {SLOW_VARIANT}: {problem}", UserWarning, stacklevel=3)
    return SLOW_VARIANT


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
