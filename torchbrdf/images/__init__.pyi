from .colour import (
    LUMINANCE as LUMINANCE,
    luminance as luminance,
)
from .difference import relative_rms as relative_rms
from .display import (
    DISPLAY_GAMMA as DISPLAY_GAMMA,
    exposure_for as exposure_for,
    stops_for as stops_for,
    tone_map as tone_map,
)
from .image_files import (
    check_image_suffix as check_image_suffix,
    png_bytes as png_bytes,
    read_image as read_image,
    read_mask as read_mask,
    read_metadata as read_metadata,
    write_image as write_image,
)
from .vectors import (
    VECTOR_SUFFIXES as VECTOR_SUFFIXES,
    read_vectors as read_vectors,
)
