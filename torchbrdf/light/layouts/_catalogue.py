"""The layouts by name."""

from importlib import import_module

from torchbrdf.light.layouts._disc import DiscLayout


def layout_of(name: str) -> DiscLayout:
    """A layout of the folder, by the name of its file."""
    layout: DiscLayout = import_module(f"{__package__}.{name}").LAYOUT
    return layout
