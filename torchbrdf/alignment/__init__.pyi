from .alignment import (
    Alignment as Alignment,
    align as align,
)
from .exposure import Exposure as Exposure
from .lamps import LampRadiance as LampRadiance
from .learned_rotation import LearnedRotation as LearnedRotation
from .settings import Range as Range
from .silhouette import (
    FoundSilhouette as FoundSilhouette,
)
