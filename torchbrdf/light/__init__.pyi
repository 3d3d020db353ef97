from ._picture import (
    LAMPS_KEY as LAMPS_KEY,
    ROWS_KEY as ROWS_KEY,
    checked_reflectance as checked_reflectance,
)
from .lamps import Lamps as Lamps, clipped_share as clipped_share
from .latlong import (
    area_mean as area_mean,
    directions_at as directions_at,
    row_solid_angles as row_solid_angles,
    texel_coordinates as texel_coordinates,
)
from .probe import LightProbe as LightProbe
from .relighting import (
    other_lights as other_lights,
    turned as turned,
)
from .rotations import (
    checked_rotation as checked_rotation,
    rotation_angle as rotation_angle,
    rotation_of as rotation_of,
    rotation_vector as rotation_vector,
)
from .settings import (
    Layout as Layout,
    Rows as Rows,
)
from .strata import (
    SIDE as SIDE,
    LightStrata as LightStrata,
)
