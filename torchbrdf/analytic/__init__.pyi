from .catalogue import (
    MODELS as MODELS,
    model_of as model_of,
)
from .cell_transport import CellTransport as CellTransport
from .image_fit import (
    Method as Method,
    fit_analytic_to_image as fit_analytic_to_image,
    image_error as image_error,
)
from .model import (
    AnalyticModel as AnalyticModel,
    Parameter as Parameter,
    Parameters as Parameters,
)
from .settings import (
    DEFAULT_METRIC as DEFAULT_METRIC,
    DEFAULT_MODEL as DEFAULT_MODEL,
    IMAGE_METRIC as IMAGE_METRIC,
    MOST_EVALUATIONS as MOST_EVALUATIONS,
    MOST_ON_A_PHOTOGRAPH as MOST_ON_A_PHOTOGRAPH,
)
from .shading_geometry import ShadingGeometry as ShadingGeometry
from .table_fit import (
    AnalyticFit as AnalyticFit,
    fit_analytic as fit_analytic,
    fit_analytic_batch as fit_analytic_batch,
)
