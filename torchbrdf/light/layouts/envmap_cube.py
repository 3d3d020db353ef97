"""Cube environment maps as the OpenEXR library defines them: +X, -X, +Y, -Y, +Z, -Z, one face below the other."""

from torchbrdf.light.layouts._cube import BACK, DOWN, FORWARD, LEFT, RIGHT, UP, CubeLayout

LAYOUT = CubeLayout({(0, row): face for row, face in enumerate((RIGHT, LEFT, UP, DOWN, BACK, FORWARD))}, to_edges=True)
