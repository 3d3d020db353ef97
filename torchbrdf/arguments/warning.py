"""Warnings that point at the line of the user."""

import sys
import warnings


def warn(message: str) -> None:
    """Warn on behalf of the line that called into this package."""
    package = f"{__name__.partition('.')[0]}."
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals["__name__"].startswith(package):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, UserWarning, stacklevel=level)
