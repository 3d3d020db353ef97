"""How far an alignment looks; without torch, for the command line's help."""

from typing import Literal

Range = Literal["near", "full"]
