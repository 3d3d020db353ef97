"""Which views the harmonic transport serves, and from where it looks at them."""

from math import asin, degrees

import torch
from torch import Tensor

from torchbrdf.transport.harmonic.grid import HELD_DISTANCE
from torchbrdf.view import SphereView, SurfacePoints, View

NEAREST = HELD_DISTANCE
"""Least distance in radii of a perspective camera from the middle of a ball; docs/transport.md tells the errors."""

_ROUNDING = 1e-3
"""Of the distance, for a field of view that is rounded to a tenth of a degree."""

_ORTHOGRAPHIC = 1e-6


def unsuited(view: View) -> str | None:
    """Why the harmonic transport cannot render a view; None where it can."""
    if type(view).visibility is not View.visibility:
        return f"{view!r} may shade itself"
    if type(view) is SphereView:
        if view.fov_deg is None or view.framing.distance >= NEAREST * (1 - _ROUNDING):
            return None
        return (
            f"the camera of {view!r} is {view.framing.distance:.3g} radii from the ball's middle, nearer than "
            f"{NEAREST:g} (fov_deg={2 * degrees(asin(1 / NEAREST)):.1f})"
        )
    toward = view.view_dirs[:, view.mask[0]]
    if not bool((toward[2] > 1 - _ORTHOGRAPHIC).all()):
        return f"the camera of {view!r} is not orthographic along -Z"
    return None


def in_perspective(view: View) -> bool:
    """Whether a view that is not `unsuited` needs the kernels of perspective."""
    return type(view) is SphereView and view.fov_deg is not None


def recurs(view: View) -> bool:
    """Whether other photographs have the same view: spheres without perspective, of which there is one a size."""
    return type(view) is SphereView and not in_perspective(view)


def surface_inside(view: View, pixels: Tensor, at: Tensor) -> SurfacePoints:
    """Points (3, Q, n n) of the shape at a grid of places inside pixels (Q,), at (n,) in [0, 1) along both sides."""
    v, u = (axis.reshape(1, -1).expand(len(pixels), -1) for axis in torch.meshgrid(at, at, indexing="ij"))
    return view.surface(pixels, u, v)


def widths_of(normals: Tensor) -> Tensor:
    """(P,): how far apart on the disc of a sphere the normals (3, P, 9) at nine places inside of pixels are.

    The fifth is that of the middle.
    """
    x, y = (normals - normals[..., 4:5])[:2]  # `norm` of what lies apart in memory takes sixty times as long
    return 2 * torch.hypot(x, y).amax(1)


def facing(view: View) -> tuple[View, Tensor | None]:
    """The view of a camera that looks at the middle of the shape, and the rotation (3, 3) from its frame to the view's.

    None where that is the frame of the view itself.
    """
    if type(view) is not SphereView or view.direction == (0.0, 0.0, -1.0):
        return view, None
    return SphereView(view.size[0], fov_deg=view.fov_deg), view.rotation
