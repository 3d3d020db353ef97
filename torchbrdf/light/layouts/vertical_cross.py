"""Vertical crosses of a cube, as HDR Shop writes them and Debevec published probes: 3 faces wide and 4 high.

The face in the middle looks forward, along -Z, as the centre of an angular map does; below that which looks down
stands the one that looks back, upside down.
"""

from torchbrdf.light.layouts._cube import DOWN, FORWARD, LEFT, RIGHT, UP, CubeLayout, Face

_UPSIDE_DOWN = Face("+Z", "+X", "+Y")

LAYOUT = CubeLayout({(1, 0): UP, (0, 1): LEFT, (1, 1): FORWARD, (2, 1): RIGHT, (1, 2): DOWN, (1, 3): _UPSIDE_DOWN})
