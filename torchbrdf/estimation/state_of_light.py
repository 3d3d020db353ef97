"""The part of an estimator's state that one light and view decide: basis images, masks, and the names of both."""

from collections.abc import Mapping
from typing import Any

from torch import Tensor

from torchbrdf.arguments import warn

_EXTRA = "_extra_state"
"""Where torch keeps in a state what `get_extra_state` gives."""


def shortened(fingerprints: str) -> str:
    """The first digits of each, which tell lights and views apart."""
    return " ".join(one[:8] for one in fingerprints.split())


def check_light(state: Mapping[str, Any], prefix: str, own: Mapping[str, Any]) -> None:
    """Raise ValueError where a state is of other materials, or of photographs of another size.

    state   of a module that holds the estimator, or of the estimator
    prefix  of the estimator's part in it
    own     what the estimator has: packed, mask_0, ... and _extra_state
    """
    origin = state.get(prefix + _EXTRA, own[_EXTRA])
    if any(origin[key] != own[_EXTRA][key] for key in ("library", "names")):
        raise ValueError("this state_dict belongs to an estimator with another material library")
    parts = {key.removeprefix(prefix): value for key, value in state.items() if key.startswith(prefix)}
    there, here = _size(parts), _size(own)
    if there is not None and there != here:
        raise ValueError(
            f"{_module(prefix)}: the state_dict is of photographs of {there}, and this estimator is of {here}; "
            "load it into an estimator of that view"
        )


def warn_of_light(state: Mapping[str, Any], prefix: str, own: Mapping[str, str]) -> None:
    """Warn where a state brings another light or view than those of the extra state `own`."""
    origin = state.get(prefix + _EXTRA, own)
    words = {"probe": "light", "view": "view"}
    changed = {
        word: f"{shortened(own[key])} -> {shortened(origin[key])}"
        for key, word in words.items()
        if own[key] != origin[key]
    }
    if changed:
        both = " and ".join(changed)
        told = " and ".join(f"{word} ({change})" for word, change in changed.items())
        warn(f"{_module(prefix)}: the state_dict holds another {told}: photographs are now explained under that {both}")


def _size(parts: Mapping[str, Any]) -> str | None:
    """Of the photographs that basis images and masks are of, in words; None where some are absent."""
    masks = [value for name, value in parts.items() if name.startswith("mask_") and isinstance(value, Tensor)]
    packed = parts.get("packed")
    if not masks or not isinstance(packed, Tensor):
        return None
    sizes = " and ".join(" x ".join(map(str, mask.shape[-2:])) for mask in masks)
    return f"{sizes} ({packed.shape[-1]} pixels)"


def _module(prefix: str) -> str:
    """What the estimator is called within the module whose state is loaded."""
    return prefix.rstrip(".") or "BRDFEstimator"
