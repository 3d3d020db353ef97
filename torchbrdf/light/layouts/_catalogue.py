"""The layouts by name, and by the proportions of a picture."""

from fractions import Fraction
from importlib import import_module

from torchbrdf.light.layouts._cube import CubeLayout
from torchbrdf.light.layouts._disc import DiscLayout

_IN_PYTHON = "(layout= and circle= of tb.LightProbe.open in Python)"
_BALL = f"--probe-layout mirror_ball with --probe-circle X Y R {_IN_PYTHON}"
_LOOKS = {
    Fraction(1): "a mirror ball or an angular map: give --probe-layout mirror_ball or --probe-layout angular "
    f"{_IN_PYTHON}",
    Fraction(3, 4): f"a vertical cross of a cube: give --probe-layout vertical_cross {_IN_PYTHON}",
    Fraction(4, 3): f"a horizontal cross of a cube, or a whole photograph of a mirror ball: give --probe-layout "
    f"horizontal_cross, or {_BALL}",
    Fraction(1, 6): "the faces of a cube, one below the other: give --probe-layout envmap_cube where they lie as in "
    f"OpenEXR's environment maps {_IN_PYTHON}; else convert it to lat-long",
    Fraction(6): "the faces of a cube, side by side, of which programs have different orders: convert it to lat-long",
}


def layout_of(name: str) -> DiscLayout | CubeLayout:
    """A layout of the folder, by the name of its file."""
    layout: DiscLayout | CubeLayout = import_module(f"{__package__}.{name}").LAYOUT
    return layout


def looks_like(height: int, width: int) -> str:
    """What a picture that is not lat-long may be, and what to do."""
    looks = _LOOKS.get(Fraction(width, height)) if height > 1 else None
    if looks is None:
        return f"crop or convert it; for a photograph of a mirror ball give {_BALL}"
    return f"it looks like {looks}"
