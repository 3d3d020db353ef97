"""How a picture of light may be laid out; without torch, for the command line's help."""

from typing import Literal

Layout = Literal["latlong", "angular", "mirror_ball"]
