from .ball import (
    Ball as Ball,
    turned_to as turned_to,
    unit_direction as unit_direction,
)
from .pinhole import PinholeCamera as PinholeCamera
