from ._catalogue import (
    layout_of as layout_of,
    looks_like as looks_like,
)
from ._disc import Circle as Circle
