"""What each command of the command line takes and does, one a file.

In: options. Out: files, lines on stdout, an exit status. A command is a module with `add_options(parser)` and
`run(options)`, whose docstring is its help. Every `--help` reads them all: what a command computes with is imported
when it runs. Modules that several share begin with an underscore.

To add a command, add a file here.
"""

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType

_FIRST = (
    "demo", "merge", "probe", "observe", "fit", "live", "compare", "analytic", "render", "bake", "precompute", "export",
    "convert", "verify", "classes",
)  # fmt: skip
"""In the order in which a user meets them; the others follow by name."""


def found() -> dict[str, ModuleType]:
    """Every command by name, in the order of the help."""
    names = [module.name for module in iter_modules(__path__) if not module.name.startswith("_")]
    names.sort(key=lambda name: (_FIRST.index(name) if name in _FIRST else len(_FIRST), name))
    return {name: import_module(f"{__name__}.{name}") for name in names}
