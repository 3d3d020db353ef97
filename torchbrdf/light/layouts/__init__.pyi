from ._catalogue import (
    layout_of as layout_of,
    looks_like as looks_like,
)
from ._cube import Cube as Cube
from ._disc import (
    Circle as Circle,
    Disc as Disc,
)
