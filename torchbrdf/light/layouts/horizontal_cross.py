"""Horizontal crosses of a cube: 4 faces wide and 3 high, left, forward (-Z), right and back in the middle row."""

from torchbrdf.light.layouts._cube import BACK, DOWN, FORWARD, LEFT, RIGHT, UP, CubeLayout

LAYOUT = CubeLayout({(1, 0): UP, (0, 1): LEFT, (1, 1): FORWARD, (2, 1): RIGHT, (3, 1): BACK, (1, 2): DOWN})
