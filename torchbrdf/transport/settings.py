"""Defaults of the transport that the command line tells, too; without torch, for its help."""

DEFAULT_SAMPLES = 4096
"""Samples a pixel, on average."""
