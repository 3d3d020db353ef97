"""How a picture of light may be laid out; without torch, for the command line's help."""

from typing import Literal

Layout = Literal["latlong", "angular", "mirror_ball", "vertical_cross", "horizontal_cross", "envmap_cube"]

Rows = Literal["centres", "poles"]
"""Where the rows of a lat-long picture lie. "centres": row y of H covers theta from pi y / H to pi (y + 1) / H, as in
files of nearly all programs. "poles": it is at theta = pi y / (H - 1), as in Mitsuba's."""
