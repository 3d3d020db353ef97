"""What is wrong with the values of a picture of light, and what is done about it."""

import math

import torch
from torch import Tensor

from torchbrdf.arguments import warn

_LARGEST_HALF = 65504.0
_NO_RADIANCE = 1e30
"""Beyond what any light has in any unit; sums and resampling stay finite below."""


def sound(radiance: Tensor, weights: Tensor, repair: bool, name: str, unknown_lamps: bool = False) -> Tensor:
    """`radiance` (3, H, W) without NaN, infinities or negative values.

    weights    (H, W) or (H, 1): the texels' solid angles up to a factor; texels of 0 become 0 unseen
    repair     fill texels that hold NaN or -infinity from their neighbours, with a warning; else they are an error
    unknown_lamps  the radiance of clipped lamps will be found: nothing is said of those at the largest half float
    raises     ValueError, for +infinity always, as nothing around a lamp tells how bright it is; and for no energy
    """
    weights = weights.expand(radiance.shape[1:])
    used = weights > 0
    total = int(used.sum())
    clipped = used & (radiance == math.inf).any(dim=0)
    if bool(clipped.any()):
        raise ValueError(
            f"{name} has {_count(clipped, 'infinite texel')} of {total} ({place(clipped)}): a lamp too bright for "
            "every exposure, or for the numbers that it was saved in (half floats end at 65504). Filling it from its "
            "neighbours would put sky in its place: `torchbrdf fit --align` finds its radiance, and writes a probe "
            "with it, aligned_probe.exr (unknown_lamps=True and tb.align in Python); else add a shorter exposure, or "
            "save the probe with 32-bit floats"
        )
    huge = used & (radiance > _NO_RADIANCE).any(dim=0)
    if bool(huge.any()):
        raise ValueError(
            f"{name} has {_count(huge, 'texel')} of {total} beyond {_NO_RADIANCE:g} ({place(huge)}): no light is so "
            "bright; write it anew, the file is damaged or holds something else than radiance"
        )
    invalid = used & ~torch.isfinite(radiance).all(dim=0)
    n_invalid = int(invalid.sum())
    if n_invalid == total:
        raise ValueError(f"{name} has no valid texel: all {total} hold NaN or infinite values")
    if n_invalid > 0:
        not_numbers = invalid & torch.isnan(radiance).any(dim=0)
        kinds = {"NaN texel": not_numbers, "-infinite texel": invalid & ~not_numbers}
        counts = " and ".join(_count(which, kind) for kind, which in kinds.items() if bool(which.any()))
        what = f"{name} has {counts} of {total} ({share_and_place(invalid, weights)})"
        if not repair:
            raise ValueError(f"{what}; give --repair-probe (repair=True in Python) to fill them from their neighbours")
        warn(f"{what}; filled from their neighbours")
        radiance = fill(radiance, used & ~invalid, invalid)
    radiance = torch.where(used, radiance, 0.0)
    largest = (radiance == _LARGEST_HALF).any(dim=0)
    if bool(largest.any()) and not unknown_lamps:  # a program that writes no infinities writes that
        warn(
            f"{name} has {_count(largest, 'texel')} of exactly {_LARGEST_HALF:.0f}, the largest half float "
            f"({place(largest)}): a lamp is probably clipped there, and all that it lights will come out too bright; "
            "save the probe with 32-bit floats, or find the lamp's radiance with `torchbrdf fit --align`"
        )
    negative = radiance < 0
    if bool(negative.any()):
        energy = radiance.detach().double().abs() * weights
        share = float((energy * negative).sum() / energy.sum())
        warn(
            f"{name} has {int(negative.sum())} negative values in {int(negative.any(dim=0).sum())} texels of {total} "
            f"({100 * share:.2g} % of the energy, lowest {float(radiance.detach().min()):.3g}); set to 0"
        )
        radiance = radiance.clamp_min(0.0)
    if not bool((radiance > 0).any()):
        raise ValueError(f"{name} has no energy: every texel is 0; give a probe that emits light")
    return radiance


def fill(radiance: Tensor, known: Tensor, wanted: Tensor) -> Tensor:
    """`radiance` (channels, H, W) with other values where `wanted`; known, wanted (H, W) bool.

    Such a texel becomes the mean of the known ones among its 8 neighbours (across the seam in phi, not across
    the poles); texels without any wait for the next pass, so holes close from their rim.
    """
    box = _box(known | wanted)
    if box != (slice(0, known.shape[0]), slice(0, known.shape[1])):  # a small disc in a large photograph
        filled = radiance.clone()
        filled[:, *box] = fill(radiance[:, *box], known[box], wanted[box])
        return filled
    filled = torch.where(known, radiance, 0.0).double()
    while bool((wanted & ~known).any()):
        stack = torch.cat([filled, known[None].double()])
        stack = torch.cat([stack[..., -1:], stack, stack[..., :1]], dim=-1)
        means = torch.nn.functional.avg_pool2d(stack, 3, stride=1, padding=(1, 0))
        newly = wanted & ~known & (means[-1] > 0.05)  # one known neighbour of nine is 0.11
        filled = torch.where(newly, means[:-1] / means[-1].clamp_min(0.05), filled)
        known = known | newly
    return torch.where(wanted, filled.to(radiance.dtype), radiance)


def share_and_place(flags: Tensor, weights: Tensor) -> str:
    """In words: which share of the sphere is flagged, and where."""
    share = float(weights[flags].sum() / weights.sum())
    return f"{100 * share:.2g} % of the sphere; {place(flags)}"


def place(flags: Tensor) -> str:
    """In words: the rows and columns of the flagged texels (H, W), or of the largest patch of them."""
    import cv2  # here, because it is slow to import

    count, _, patches, _ = cv2.connectedComponentsWithStats(flags.to("cpu", torch.uint8).numpy(), connectivity=8)
    left, top, width, height, _ = max(patches[1:].tolist(), key=lambda patch: (patch[4], -patch[1], -patch[0]))
    rows, columns = (
        f"{axis} {start}" if extent == 1 else f"{axis}s {start} to {start + extent - 1}"
        for axis, start, extent in (("row", top, height), ("column", left, width))
    )
    return ("" if count == 2 else f"in {count - 1} places, the largest at ") + f"{rows}, {columns}, counted from 0"


def _count(flags: Tensor, noun: str) -> str:
    count = int(flags.sum())
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _box(flags: Tensor) -> tuple[slice, slice]:
    rows, columns = (flags.any(dim=axis).nonzero().ravel() for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
