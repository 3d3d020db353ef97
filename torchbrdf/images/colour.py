"""What a colour of linear RGB weighs."""

from torch import Tensor

LUMINANCE = (0.2126, 0.7152, 0.0722)  # Rec. 709 / sRGB primaries


def luminance(radiance: Tensor) -> Tensor:
    """Rec. 709 luminance (...) of linear RGB with the channels first (3, ...)."""
    red, green, blue = radiance
    return LUMINANCE[0] * red + LUMINANCE[1] * green + LUMINANCE[2] * blue
