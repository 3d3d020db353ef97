from .gradients import warn_of_lost_gradient as warn_of_lost_gradient
from .shapes import check_last as check_last
from .types import (
    check_types as check_types,
    several as several,
    whole as whole,
)
from .warning import warn as warn
