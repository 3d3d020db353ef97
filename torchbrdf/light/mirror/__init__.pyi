from .matte import looks_matte as looks_matte
from .metals import Metal as Metal
from .photographs import (
    MirrorPhotograph as MirrorPhotograph,
    MirrorProbe as MirrorProbe,
    unwrapped as unwrapped,
)
from .picture import MirrorPicture as MirrorPicture
from .reflection import Reflection as Reflection
