from .ball import (
    Ball as Ball,
    turned_to as turned_to,
    unit_direction as unit_direction,
)
from .coverage import (
    touched as touched,
    wholly_inside as wholly_inside,
)
from .pinhole import PinholeCamera as PinholeCamera
