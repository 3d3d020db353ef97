from ._table_kernels import SHOWN as SHOWN
from .basis import HarmonicBasis as HarmonicBasis
from .cache import (
    files_of as files_of,
    is_precomputed as is_precomputed,
    transport_of as transport_of,
)
from .grid import (
    Zone as Zone,
    zones as zones,
)
from .light import TurningLight as TurningLight
from .splines import SUPPORT as SUPPORT
from .tables import table_pictures as table_pictures
from .transport import (
    HarmonicTransport as HarmonicTransport,
    frequencies_of as frequencies_of,
    spectrum as spectrum,
)
from .views import (
    NEAREST as NEAREST,
    in_perspective as in_perspective,
    unsuited as unsuited,
)
