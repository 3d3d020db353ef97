"""In which frame normals are given: which axes of a map must be turned, where that is certain."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from torchbrdf.view._normal_encoding import EXPECTED

_MOST_AWAY = 0.1
"""Share of the normals that may face away from the camera: noise and rounding near the silhouette."""

_LARGEST = 1024
"""Larger maps are looked at after averaging."""

_FIT, _MISFIT = 0.6, 0.2
_SUPPORTED_FIT = 0.3
_CERTAIN, _SUPPORTED = 5.0, 3.0
"""Of the agreement of slopes times the root of the number of places, for noise 0 +- 0.8: alone, and where the
silhouette says the same."""

_FEWEST_SLOPE = 0.25
_CREASE_COSINE = 0.7
_LEAST_TWIST = 0.04
"""Of how slopes change across their direction, relative to along it: less may be rounding to 8 bits."""

_GRAZING = 0.7
"""Z of normals at a silhouette, at most; that of small shapes is wide."""

_STEEP = 0.85
_CLEAR = 0.6
_LEAST_TURN = 0.05


@dataclass(frozen=True)
class Righted:
    """Normals with X right, Y up and Z towards the camera, and what was done or is doubtful."""

    normals: Tensor
    notes: list[str]


def righted(normals: Tensor, view_dirs: Tensor, mask: Tensor) -> Righted:
    """Normals in the frame of the view.

    normals    (3, H, W)  unit vectors, 0 where there is none
    view_dirs  (3, H, W)  unit vectors towards the camera
    mask       (1, H, W)  pixels of the shape

    Slopes of a surface fit together: how the slope in x changes with y is how the slope in y changes with x; where
    Y points down the two are opposite. And at the silhouette normals point outwards. Raises ValueError where many
    normals face away from the camera, or the slopes fit together in no frame that the silhouette allows.
    """
    used = mask[0]
    facing = ((normals * view_dirs).sum(0) > 0) & used
    share = 1 - int(facing.sum()) / max(int(used.sum()), 1) if used.any() else 0
    if share == 1:
        return _from_behind(normals, view_dirs, used)
    if share > _MOST_AWAY:
        raise ValueError(
            f"{share:.0%} of its normals face away from the camera, as in another frame (of the world, or Z into the "
            f"scene) or with other channels; {EXPECTED}"
        )
    upside_down = _mirrored(normals, 1)
    outward_x, outward_y = _outward(normals, facing)
    supported = outward_x > _CLEAR and outward_y < -_CLEAR
    founded = _SUPPORTED if supported else _CERTAIN
    fit, would_fit = (_agreement(each, view_dirs, facing, founded) for each in (normals, upside_down))
    if fit < _MISFIT and would_fit > (_SUPPORTED_FIT if supported else _FIT):
        if outward_x < -0.3 or outward_y > 0.3:
            raise ValueError(
                f"its slopes do not fit together with Y up, and with Y down its silhouette points inwards; {EXPECTED}"
            )
        return Righted(upside_down, ["its normals have Y down and were turned to Y up"])
    if fit < _MISFIT < would_fit:
        return Righted(normals, ["its slopes fit together better with Y down, but not well; taken as Y up"])
    if outward_y < -_CLEAR and fit < _MISFIT:
        return Righted(normals, ["its normals point inwards above and below: hollow, or Y down; taken as Y up"])
    return Righted(normals, [])


def _from_behind(normals: Tensor, view_dirs: Tensor, used: Tensor) -> Righted:
    """Where all normals face away: Z into the scene, with Y up or (as OpenCV has it) down."""
    turned = _mirrored(normals, 2)
    if bool(((turned * view_dirs).sum(0) > 0)[used].all()):
        upside_down = _mirrored(turned, 1)
        outward_x, outward_y = _outward(turned, used)
        would_fit = _agreement(upside_down, view_dirs, used, _SUPPORTED)
        if outward_x > _CLEAR and outward_y > _CLEAR and would_fit < _MISFIT:
            return Righted(turned, ["its normals have Z into the scene and were turned towards the camera"])
        if outward_x > _CLEAR and outward_y < -_CLEAR and would_fit > _SUPPORTED_FIT:
            note = "its normals have Y down and Z into the scene and were turned to Y up and Z towards the camera"
            return Righted(upside_down, [note])
    raise ValueError(f"no pixel under the mask has a normal that faces the camera; {EXPECTED}")


def flat_surroundings(normals: Tensor, around: Tensor) -> bool:
    """Whether pixels that face the camera are what surrounds a shape, whose normals turn away beside them.

    around  (H, W)  bool, pixels of one normal
    """
    shape = (normals != 0).any(0) & ~around
    if float(normals[2][around].min()) < 0.99:
        return False
    rim = normals[2][shape & _grown(around)]
    return len(rim) >= 8 and float(((rim > 0) & (rim < _STEEP)).double().mean()) > 0.7


def _mirrored(normals: Tensor, axis: int) -> Tensor:
    signs = torch.ones(3, 1, 1, dtype=normals.dtype)
    signs[axis] = -1
    return normals * signs


def _agreement(normals: Tensor, view_dirs: Tensor, used: Tensor, founded: float) -> float:
    """Of slopes with each other, -1 to 1; 0 where it may be noise.

    The clearest over blocks of pixels of all sizes: noise and rounding hide the slopes of small ones.
    """
    height, width = used.shape
    block, clearest = -(-max(height, width) // _LARGEST), 0.0
    while min(height, width) // block >= 4:
        found, places = _agreement_of_blocks(normals, view_dirs, used, block)
        if abs(found) * places**0.5 > founded and abs(found) > abs(clearest):
            clearest = found
        block *= 2
    return clearest


def _agreement_of_blocks(normals: Tensor, view_dirs: Tensor, used: Tensor, block: int) -> tuple[float, int]:
    """And at how many places, 0 where slopes hardly change across their direction."""
    weight = used[None].to(normals.dtype)
    covered = avg_pool2d(weight, block)
    ray = view_dirs / view_dirs[2:].clamp_min(1e-6)
    n, ray = (avg_pool2d(vectors * weight, block) / covered.clamp_min(1e-6) for vectors in (normals, ray))
    n = n / n.norm(dim=0, keepdim=True).clamp_min(1e-6)
    toward = (n * ray).sum(0)  # for an orthographic camera n_z; in perspective the slopes of the logarithm of depth
    sound = (covered[0] > 0.75) & (toward > _FEWEST_SLOPE)
    p, q = -n[0] / toward.clamp_min(1e-6), -n[1] / toward.clamp_min(1e-6)
    whole = sound[:-1, :-1] & sound[:-1, 1:] & sound[1:, :-1] & sound[1:, 1:]
    beside = (n[:, :, 1:] * n[:, :, :-1]).sum(0) > _CREASE_COSINE
    below = (n[:, 1:] * n[:, :-1]).sum(0) > _CREASE_COSINE
    whole &= beside[:-1] & beside[1:] & below[:, :-1] & below[:, 1:]
    p_y, q_x = _up(p)[whole], _right(q)[whole]
    along = torch.hypot(_right(p)[whole], _up(q)[whole])
    across = torch.hypot(p_y, q_x)
    if len(across) == 0 or float(across.sum()) <= _LEAST_TWIST * float(along.sum()):
        return 0.0, 0
    weights = across.clamp_max(4 * float(across[across > 0].median()))
    fit = float((weights * 2 * p_y * q_x / across.square().clamp_min(1e-30)).sum() / weights.sum())
    return fit, len(across)


def _up(values: Tensor) -> Tensor:
    return (values[:-1, :-1] + values[:-1, 1:] - values[1:, :-1] - values[1:, 1:]) / 2


def _right(values: Tensor) -> Tensor:
    return (values[:-1, 1:] + values[1:, 1:] - values[:-1, :-1] - values[1:, :-1]) / 2


def _outward(normals: Tensor, used: Tensor) -> tuple[float, float]:
    """How far normals at the silhouette point out of it in x and in y, -1 to 1; 0 where there is little of one.

    The border of the image is no silhouette.
    """
    solid = pad(used[None].float(), (2, 2, 2, 2), mode="replicate")
    blurred = avg_pool2d(solid, 3, stride=1)
    x = (blurred[0, 1:-1, :-2] - blurred[0, 1:-1, 2:]) / 2
    y = (blurred[0, 2:, 1:-1] - blurred[0, :-2, 1:-1]) / 2
    length = torch.hypot(x, y)
    rim = used & _grown(~used) & (length > 1e-3) & (normals[2].abs() < _GRAZING)
    if int(rim.sum()) < 8:
        return 0.0, 0.0
    found = []
    for axis, outward in ((0, x), (1, y)):
        products = normals[axis][rim] * (outward / length.clamp_min(1e-6))[rim]
        total = float(products.abs().sum())
        found.append(float(products.sum()) / total if total > _LEAST_TURN * int(rim.sum()) else 0.0)
    return found[0], found[1]


def _grown(region: Tensor) -> Tensor:
    """With the four neighbours of every pixel."""
    padded = pad(region, (1, 1, 1, 1))
    return region | padded[1:-1, :-2] | padded[1:-1, 2:] | padded[:-2, 1:-1] | padded[2:, 1:-1]
