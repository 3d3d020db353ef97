"""What a user chooses of an estimate, with its defaults; without torch, for the command line's help."""

from typing import Literal, get_args

PAPER_PENALTY = 0.5
"""lambda of [CBP21, eq. 25]."""

Penalty = Literal["auto", "paper"] | float
DEFAULT_PENALTY: Penalty = "auto"

Constraint = Literal["nonnegative", "convex", "energy", "lobes"]
CONSTRAINTS: tuple[Constraint, ...] = get_args(Constraint)

N_CLASSES = 4
N_DIMS = 4
"""K and N of [CBP21, sec. IV]."""
