from .colour import (
    LUMINANCE as LUMINANCE,
    luminance as luminance,
)
from .difference import relative_rms as relative_rms
from .display import (
    DISPLAY_GAMMA as DISPLAY_GAMMA,
    exposure_for as exposure_for,
    exposure_for_light as exposure_for_light,
    stops_for as stops_for,
    tone_map as tone_map,
    with_rim as with_rim,
)
from .encodings import (
    DECODERS as DECODERS,
    LINEAR as LINEAR,
    SRGB as SRGB,
    Transfer as Transfer,
)
from .formats import Window as Window
from .formats._catalogue import (
    kind_by_suffix as kind_by_suffix,
    readable_suffixes as readable_suffixes,
)
from .formats._space_names import SPACE_KEYS as SPACE_KEYS
from .masks import (
    Mask as Mask,
    open_mask as open_mask,
    read_mask as read_mask,
)
from .pictures import (
    Picture as Picture,
    read_environment_map as read_environment_map,
    read_image as read_image,
    read_metadata as read_metadata,
    read_picture as read_picture,
)
from .primaries import (
    SPACES as SPACES,
    Primaries as Primaries,
    conversion as conversion,
    converted as converted,
)
from .settings import (
    DEFAULT_SPACE as DEFAULT_SPACE,
    ColourSpace as ColourSpace,
    Encoding as Encoding,
    EnvironmentMap as EnvironmentMap,
)
from .shooting import (
    RAW_SUFFIXES as RAW_SUFFIXES,
    Shooting as Shooting,
    read_shooting as read_shooting,
)
from .vectors import read_vectors as read_vectors
from .writing import (
    DISPLAY_SUFFIXES as DISPLAY_SUFFIXES,
    LONGEST_KEY as LONGEST_KEY,
    check_image_suffix as check_image_suffix,
    png_bytes as png_bytes,
    write_image as write_image,
)
