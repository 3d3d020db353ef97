from .basis_images import (
    BasisImages as BasisImages,
    own_images as own_images,
)
from .sampled import (
    gather_columns as gather_columns,
    plan_transport as plan_transport,
    render_columns as render_columns,
    sampled_basis as sampled_basis,
)
from .sampling import TransportSamples as TransportSamples
from .settings import DEFAULT_SAMPLES as DEFAULT_SAMPLES
