"""Names of colour spaces and of encodings; without torch, for the command line's help."""

from typing import Literal

ColourSpace = Literal["rec709", "rec2020", "p3-d65", "aces-ap0", "aces-ap1", "xyz"]
"""Linear RGB spaces by their primaries: see `primaries.SPACES`."""

DEFAULT_SPACE: ColourSpace = "rec709"

EnvironmentMap = Literal["latlong", "cube"]
"""How an .exr file that says to be one holds light from all directions [EXR]."""

Encoding = Literal["linear", "srgb", "gamma2.2"]
"""What integers of a picture stand for: see `encodings.DECODERS`."""
