"""Defaults of a comparison; without torch, for the command line's help."""

COMPARISON_SIZE, COMPARISON_SAMPLES = 192, 1024
"""Pixels along a side, and light samples a pixel, of the spheres."""
