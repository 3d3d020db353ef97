"""Names of responses; without torch, for the command line's help."""

from typing import Literal

Response = Literal["linear", "srgb", "estimate"]
"""What a camera made of radiance: see `response.Curve`."""
