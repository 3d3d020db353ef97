"""The analytic BRDFs, one a file: pure functions of a geometry and of parameters, each with its `MODEL`.

In: a `ShadingGeometry` and parameters that broadcast against its (..., 1) fields. Out: f_r in 1/sr without the cosine;
what a function gives below the horizon is finite and means nothing.

To add a model, add a file here: it is named after the model, with _ for -, and defines `MODEL`, an `AnalyticModel`.
"""

from pkgutil import iter_modules

_FIRST = (
    "lambert", "ggx", "metallic-roughness", "ggx-dielectric", "rough-conductor", "rough-plastic", "cook-torrance",
    "cook-torrance-dielectric", "ward", "ward-duer", "ward-bounded", "ashikhmin-shirley",
    "ashikhmin-shirley-dielectric", "ashikhmin-shirley-coupled", "low-microfacet", "principled", "oren-nayar",
)  # fmt: skip
"""From the plain to the special; the others follow by name."""

_FOUND = [module.name.replace("_", "-") for module in iter_modules(__path__)]

NAMES = tuple(sorted(_FOUND, key=lambda name: (_FIRST.index(name) if name in _FIRST else len(_FIRST), name)))
"""Of all models, for lists that open at once: only `catalogue` imports them."""
