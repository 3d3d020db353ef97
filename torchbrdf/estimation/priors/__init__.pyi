from .bank import (
    Explanation as Explanation,
    PriorBank as PriorBank,
    redundancy as redundancy,
)
from .neighbourhoods import (
    farthest_points as farthest_points,
    image_angles as image_angles,
)
from .variances import prior_variances as prior_variances
from .whole_library import whole_variances as whole_variances
