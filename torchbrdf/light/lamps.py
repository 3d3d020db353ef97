"""What a picture of light may be too narrow for: its texels at the ceiling of their channel, of lamps or of more.

Radiance is linear in theirs, so it is kept beside the whole, resampled alike: times a factor, it gives the probe whose
lamp is brighter. Found among the picture's own pixels, before resampling blurs their plateau.
"""

from dataclasses import dataclass, replace
from itertools import permutations
from math import inf

import torch
from torch import Tensor

from torchbrdf.light._soundness import place

LARGEST_SHARE = 0.005
"""Of the sphere, up to which texels at the ceiling can be a lamp: a disc of 8 degrees' radius."""

_LARGEST_UNKNOWN = 0.02
"""Of the sphere, up to which infinite texels are taken for lamps, of one radiance."""

_ROUNDING = 1e-3
_SAME = 1e-6
"""Of a value, up to which 32-bit floats are the same but for rounding."""

_MOST_SAME, _MOST_SAME_SHARE = 4, 0.01
"""Texels that hold the same at a smooth maximum: those around a corner, or a share of all within `_ROUNDING` of it."""

_GENTLE = 1e-2
"""How far, at most, radiance has fallen beside the texels within `_ROUNDING` of a smooth maximum."""

_LEAST_CONTRAST = 3.0
"""How many times as bright as the mean a lamp is."""

_CERTAIN_TEXELS = 4
_MOST_EQUAL = 0.1
"""Share of bright neighbours that hold the same numbers, up to which a picture is a photograph and not computed."""

_PLACES = 128
"""Along a row of a resampled picture: nearer ones may be of one texel of the file."""

_FEWEST_PAIRS = 100
"""Of such places, that tell which it is."""


@dataclass(frozen=True, eq=False)
class Lamps:
    """The texels of a probe that may be clipped.

    radiance  (3, H, 2 H): what the probe's radiance has of them; 0 in channels that are below their ceiling
    about     how many of the picture's own texels they are, where, and what they hold, in words
    unknown   they were infinite: their radiance is only where a search begins
    certain   they are clipped, and not just as bright as each other
    """

    radiance: Tensor
    about: str
    unknown: bool
    certain: bool

    @property
    def channels(self) -> Tensor:
        """(3,) bool, on the CPU: those in which they may be clipped."""
        return (self.radiance.detach() > 0).flatten(1).any(1).cpu()

    def of(self, radiance: Tensor) -> "Lamps":
        """The same lamps resampled."""
        return replace(self, radiance=radiance)


def bounded(picture: Tensor, weights: Tensor, name: str | None = None) -> tuple[Tensor, Tensor]:
    """A picture (3, h, w) with its infinite values at its largest finite one, and (3, h, w) bool where those were.

    weights   (h, w) or (h, 1): solid angles; texels of 0 do not count
    name      of a picture of all the light, where infinite values must be no more than lamps, else ValueError
    """
    weights = weights.expand(picture.shape[1:])
    used = weights > 0
    infinite = (picture == inf) & used
    share = float((weights * infinite.any(0)).sum() / weights.sum())
    if name is not None and share > _LARGEST_UNKNOWN:
        raise ValueError(
            f"{name} is infinite in {share:.1%} of the sphere: that is more than lamps, of which one radiance could be "
            "found; add shorter exposures"
        )
    finite = picture[torch.isfinite(picture) & used]
    return (torch.where(infinite, finite.max(), picture) if len(finite) else picture), infinite


def lamps_of(picture: Tensor, weights: Tensor, infinite: Tensor | None = None) -> Lamps | None:
    """The lamps of a sound picture (3, h, w), with radiance in its own pixels; None where there are none.

    weights   (h, w) or (h, 1): solid angles up to a factor
    infinite  (3, h, w) bool: of `bounded`
    Texels at the largest value of their channel, where that is no smooth maximum, beside another such one, or in such a
    plateau of another channel that ends at the same value, or alone where all channels are largest; together no larger
    than LARGEST_SHARE, and bright. Infinite texels are lamps, see `bounded`.
    """
    values, weights = picture.detach(), weights.expand(picture.shape[1:])
    unknown = infinite is not None and bool(infinite.any())
    clipped = infinite if infinite is not None and unknown else _at_ceiling(values, weights)
    texels = clipped.any(0)
    count = int(texels.sum())
    if count == 0:
        return None
    held = sorted({float(f"{value:.4g}") for value in values[clipped].tolist()})
    span = " or ".join(f"{value:g}" for value in (held if len(held) < 4 else held[:: len(held) - 1]))
    radiance = "infinite radiance" if unknown else f"radiance {span}"
    return Lamps(
        radiance=torch.where(clipped, picture, 0),
        about=f"{count} texel{'' if count == 1 else 's'} of {radiance} ({place(texels)})",
        unknown=unknown,
        certain=unknown or _certain(values, clipped),
    )


def clipped_share(radiance: Tensor, weights: Tensor) -> float:
    """The share of the sphere that is clipped where that is more than lamps, as in a panorama of 8 bits; else 0.

    radiance, weights  as for `lamps_of`, or resampled: regions so large keep their plateaus
    """
    values, weights = radiance.detach(), weights.expand(radiance.shape[1:])
    flags, share = _at_maximum(values, weights)
    one_level, other_regions = _cuts(values, flags)
    told = (one_level and other_regions) or ((one_level or other_regions) and _photographed(values, flags.any(0)))
    return share if share > LARGEST_SHARE and told else 0.0


def _at_maximum(values: Tensor, weights: Tensor) -> tuple[Tensor, float]:
    """(3, h, w) bool: the texels at the largest value of their channel, see `_smooth`; their share of the sphere."""
    largest, used = values.amax((1, 2), keepdim=True), weights > 0
    flags = (values >= largest * (1 - _ROUNDING)) & used
    flags &= ~_smooth(values, flags, largest, used)
    return flags, float((weights * flags.any(0)).sum() / weights.sum())


def _smooth(values: Tensor, flags: Tensor, largest: Tensor, used: Tensor) -> Tensor:
    """(3, 1, 1) bool: channels whose largest values are the top of a light that was not clipped.

    Such radiance falls off quadratically: hardly two texels hold the same, and beside those within a thousandth of the
    largest value it is little below. A lamp's edge is steep, and what was clipped holds one value.
    """
    same = ((values >= largest * (1 - _SAME)) & flags).sum((1, 2), keepdim=True)
    few = same <= (_MOST_SAME_SHARE * flags.sum((1, 2), keepdim=True)).clamp_min(_MOST_SAME)
    beside = (_neighbours(flags) > 0) & ~flags & used
    fallen = ((largest - values) * beside).sum((1, 2), keepdim=True)
    return few & (fallen <= _GENTLE * largest * beside.sum((1, 2), keepdim=True))


def _neighbours(flags: Tensor) -> Tensor:
    """(3, h, w): the share of flagged ones among the nine texels around each, across the seam."""
    wrapped = torch.cat([flags[..., -1:], flags, flags[..., :1]], -1).float()
    return torch.nn.functional.avg_pool2d(wrapped, 3, 1, (1, 0))


def _at_ceiling(values: Tensor, weights: Tensor) -> Tensor:
    """(3, h, w) bool: the texels that may be clipped; none where they are too many or too dim."""
    flags, of_sphere = _at_maximum(values, weights)
    if of_sphere > LARGEST_SHARE:
        return torch.zeros_like(flags)
    ceiling, share = values.amax((1, 2), keepdim=True), weights / weights.sum()
    flags &= ceiling > _LEAST_CONTRAST * (values * share).sum((1, 2), keepdim=True)
    plateau = flags & (_neighbours(flags) > 1.5 / 9)
    if not bool(plateau.any()):
        return flags & flags.all(0)
    level = (ceiling * plateau.flatten(1).any(1)[:, None, None]).max()
    return plateau | (flags & plateau.any(0) & ((ceiling - level).abs() <= _ROUNDING * level))


def _certain(values: Tensor, clipped: Tensor) -> bool:
    """Whether texels are as bright as each other because they are clipped.

    A lamp of one radiance looks so, too, in a picture that was computed, where other neighbours are equal as well. In a
    photograph they are not; and its channels are clipped at one level, or over other regions.
    """
    texels = clipped.any(0)
    if int(texels.sum()) < _CERTAIN_TEXELS:
        return False
    equal, pairs = _equal_pairs(values, texels, 1)
    return equal <= _MOST_EQUAL * pairs and any(_cuts(values, clipped))


def _photographed(values: Tensor, texels: Tensor) -> bool:
    """Whether what is bright beside some texels differs from place to place, as it does in no picture that was computed
    of areas of one radiance."""
    equal, pairs = _equal_pairs(values, texels, max(1, values.shape[2] // _PLACES))
    return pairs >= _FEWEST_PAIRS and equal <= _MOST_EQUAL * pairs


def _equal_pairs(values: Tensor, texels: Tensor, apart: int) -> tuple[int, int]:
    """How many pairs of bright texels, of none of these and so many columns apart, hold the same; and how many are."""
    bright = (values.mean(0) > values.mean()) & ~texels
    pairs = bright[:, apart:] & bright[:, :-apart]
    return int(((values[..., apart:] == values[..., :-apart]).all(0) & pairs).sum()), int(pairs.sum())


def _cuts(values: Tensor, clipped: Tensor) -> tuple[bool, bool]:
    """Whether the channels of what may be clipped end at one level, and whether they end over other regions.

    Regions that do not overlap are lights of other colours in other places.
    """
    levels = torch.where(clipped, values, 0).amax((1, 2))
    levels = levels[levels > 0]
    one_level = len(levels) > 1 and float(levels.max() - levels.min()) <= _ROUNDING * float(levels.max())
    return one_level, any(_outlasts(values[j], clipped[j], clipped[i]) for i, j in permutations(range(3), 2))


def _outlasts(channel: Tensor, own: Tensor, region: Tensor) -> bool:
    """Whether a channel (h, w) goes on where another is clipped: its region is another and overlaps, or it has none
    and changes there."""
    if own.any() or not region.any():
        return bool((own & region).any()) and not torch.equal(own, region)
    inside = channel[region]
    return float(inside.max() - inside.min()) > _GENTLE * float(inside.max())
