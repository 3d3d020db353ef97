"""Deep paths that 0.6.0 documented: they work in 0.7 and 0.8, with a warning; 0.9 forgets them."""

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

MOVED = {
    "analytic_export": "analytic.export",
    "analytic_models": "analytic",
    "augment": "learning",
    "brdf_difference": "brdf",
    "cell_transport": "analytic",
    "comparison": "report",
    "comparison_page": "report",
    "constraints": "estimation.constraints",
    "exposure": "alignment",
    "gltf": "analytic.export",
    "learned_rotation": "alignment",
    "materialx": "analytic.export",
    "mitsuba_material": "analytic.export",
    "observability": "estimation",
    "posterior": "estimation",
    "reflectance_maps": "learning",
    "shading_geometry": "analytic",
}
"""Module of 0.6.0 -> what hands its documented names on now."""


class MovedModules(MetaPathFinder, Loader):
    """Finds the old modules: empty ones, which take every name from where it is now."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """A module of `MOVED` under the name of this package."""
        package, _, module = name.rpartition(".")
        return ModuleSpec(name, self) if package == __package__ and module in MOVED else None

    def exec_module(self, module: ModuleType) -> None:
        """Say where it is now."""
        old = module.__name__
        new = f"{__package__}.{MOVED[old.rpartition('.')[2]]}"
        warnings.warn(f"{old} is now {new}; torchbrdf 0.9 forgets the old path", DeprecationWarning, stacklevel=2)

        def __getattr__(name: str) -> Any:
            return getattr(import_module(new), name)

        module.__getattr__ = __getattr__  # type: ignore[method-assign]


def install() -> None:
    """Once a process, behind all other finders: where nothing has moved, nothing is asked of it."""
    if not any(isinstance(finder, MovedModules) for finder in sys.meta_path):
        sys.meta_path.append(MovedModules())
