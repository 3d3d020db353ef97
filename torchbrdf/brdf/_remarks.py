"""What to say of a table that is sound, and yet may not be what was meant."""

from torch import Tensor

from torchbrdf.brdf.albedo import WRONG_ALBEDO, reflects_too_much

_FEW = 0.6
"""Share of its cells that a table should have measured: of 16 materials of the RGL database the least is 0.83."""


def brightness(albedo: Tensor, much: float = WRONG_ALBEDO) -> str | None:
    """Of a directional albedo (4, 3): that it is 0, or above `much`."""
    if not albedo.any():
        return "reflects nothing: f_r is 0 wherever it was looked at; was the file written whole? Else leave it out"
    said = reflects_too_much(albedo, much)
    if said is None or much < WRONG_ALBEDO:
        return said
    return f"{said}; is it f_r in 1/sr, without the cosine? A factor counts in every fit: divide it, or leave it out"


def holes(measured_share: float) -> str | None:
    """That a table measured few of its cells: it voids those of every combination it is part of."""
    if measured_share >= _FEW:
        return None
    advice = "what it has a weight in lacks them, too: leave it out"
    return f"{1 - measured_share:.0%} of its cells were not measured; {advice}"
