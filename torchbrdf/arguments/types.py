"""Arguments of another type than a call takes, swapped ones above all."""

import operator
from collections.abc import Iterable
from typing import SupportsIndex, TypeVar

Wanted = TypeVar("Wanted")

_MADE_BY = {
    "AnalyticFit": "make one with tb.fit_analytic(material, model)",
    "BasisImages": "make them with tb.render_basis(library, probe, view)",
    "Format": "take one of torchbrdf.analytic.export.FORMATS, by its name",
    "LightProbe": "open one with tb.LightProbe.open(path)",
    "MaterialClasses": "make them with tb.MaterialClasses.fit(library)",
    "MaterialLibrary": "open one with tb.MaterialLibrary.default()",
    "MerlTable": "take result.brdf(library), library.table(name) or tb.read_table(path)",
    "View": "make one, such as tb.SphereView(32)",
}


def check_types(call: str, **given: tuple[object, type]) -> None:
    """Raise ValueError where an argument is not of its type, or in the place of another.

    call   its name, as users write it
    given  each argument with its type, one that `_MADE_BY` holds, in the order in which the call takes them
    """
    for name, (value, wanted) in given.items():
        if isinstance(value, wanted):
            continue
        swapped = any(isinstance(value, other) for _, other in given.values())
        remedy = f"the order is {call}({', '.join(given)})" if swapped else _MADE_BY[wanted.__name__]
        raise ValueError(f"{call}: {name} must be a {wanted.__name__}, got {_called(value)}; {remedy}")


def several(
    call: str, name: str, given: Wanted | Iterable[Wanted], wanted: type[Wanted], **others: tuple[object, type]
) -> tuple[Wanted, ...]:
    """What a call takes one of or a sequence of, as a sequence; else ValueError, see `check_types`.

    name    of the argument, the first of the call
    others  the arguments after it, as `check_types` takes them
    """
    found = tuple(given) if isinstance(given, Iterable) else (given,)
    for one in found:
        check_types(call, **{name: (one, wanted)}, **others)
    return found


def whole(name: str, value: SupportsIndex) -> int:
    """A whole number of any type, as an int. Raises ValueError where an argument of this name is none."""
    try:
        return operator.index(value)
    except TypeError:
        raise ValueError(f"{name} must be a whole number, got {_called(value)}") from None


def _called(value: object) -> str:
    return repr(value) if value is None or isinstance(value, str | int | float) else f"a {type(value).__name__}"
