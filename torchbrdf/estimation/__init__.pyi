from .classes import MaterialClasses as MaterialClasses
from .estimator import BRDFEstimator as BRDFEstimator
from .image_space import (
    ImageSpace as ImageSpace,
    UnformedSpace as UnformedSpace,
    residual_scale as residual_scale,
)
from .masked_photographs import check_observation as check_observation
from .observability import (
    PHI_D as PHI_D,
    Gap as Gap,
    Observability as Observability,
)
from .posterior import Posterior as Posterior
from .reconstruction import Reconstruction as Reconstruction
from .settings import (
    CONSTRAINTS as CONSTRAINTS,
    DEFAULT_PENALTY as DEFAULT_PENALTY,
    N_CLASSES as N_CLASSES,
    N_DIMS as N_DIMS,
    PAPER_PENALTY as PAPER_PENALTY,
    Constraint as Constraint,
    Penalty as Penalty,
)
