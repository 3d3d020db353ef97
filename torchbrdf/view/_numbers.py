"""Numbers written as text."""

import warnings
from typing import Any

import numpy as np


def numbers(text: bytes, kind: type[np.generic]) -> np.ndarray[Any, np.dtype[Any]]:
    """The numbers of a text, separated by white space, up to the first word that is none."""
    if not text or text.isspace():
        return np.empty(0, kind)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "string or file could not be read to its end", DeprecationWarning)
        try:
            return np.fromstring(text, kind, sep=" ")
        except (ValueError, DeprecationWarning):
            return _one_by_one(text, kind)


def _one_by_one(text: bytes, kind: type[np.generic]) -> np.ndarray[Any, np.dtype[Any]]:
    found = []
    for word in text.split():
        try:
            found.append(kind(word.decode("ascii")))
        except (ValueError, OverflowError):
            break
    return np.array(found, kind)
