"""How finely a picture is looked up."""

from math import ceil

_MOST, _LEAST = 6, 3


def lookups(rows: int, height: int) -> int:
    """Along a side of a texel of a lat-long map of so many rows, of a picture about as fine as one of `rows`."""
    return min(_MOST, max(_LEAST, ceil(_MOST * rows / height)))
