"""The analytic fits to MERL that were published by Ngan et al. [NDM05] and Low et al. [LKYU12], read and evaluated.

A `.fit` file of Peers' BBM names a material and an aggregate of a Lambertian and a lobe on each line:

    brass = Aggregate(Lambertian(albedo = [...]), NganWard(albedo = [...], roughness = 0.05))

The definitions are BBM's, but for He et al.'s, which is from their paper, and with two changes that the tables of MERL
ask for. Blinn-Phong is a power of cos theta_h, not
of the cosine to the mirror direction: the median error of the cube root is 0.160 instead of 0.172. And the fits of
[NDM05] lack the factors 1, 1.15 and 1.66 of MERL's channels: the albedos of Cook-Torrance are 0.98, 0.85 and 0.59 of
those in [LKYU12], and with the factors Ashikhmin-Shirley, for one, is off by 0.115 instead of 0.154. How well all fit:
scripts/benchmarks/published_fits.py.

Lengths in the fits of He et al.'s model are taken in micrometres, under light of 0.55: the median error in L2, which
[NDM05] minimised, is then 0.48, and 0.57 if they are in wavelengths. Where a lobe is a model of torchbrdf but for
constants, it is evaluated as that model.
"""

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

import torch
from scipy.special import lambertw
from torch import Tensor

from torchbrdf.analytic import MODELS, ShadingGeometry
from torchbrdf.analytic.fresnel import dielectric
from torchbrdf.brdf.merl import CHANNEL_SCALE
from torchbrdf.experiments import SHARED

FITS = SHARED / "published_fits"

Numbers = Mapping[str, Tensor]
"""Name -> (1,) or (3,) float64."""


@dataclass(frozen=True)
class PublishedLobe:
    """What the name of a lobe in a `.fit` file means.

    model    of `MODELS`, or None where torchbrdf has none
    renamed  (published name, name in the model, factor) of each of its parameters
    f_r      of a geometry and the published numbers, (N, 3): where there is no model
    """

    model: str | None
    renamed: tuple[tuple[str, str, float], ...] = ()
    f_r: Callable[[ShadingGeometry, Numbers], Tensor] | None = None


def _blinn_phong(geometry: ShadingGeometry, lobe: Numbers) -> Tensor:
    """albedo (n + 2) / (2 pi) cos^n theta_h."""
    fall = torch.exp(lobe["sharpness"] * geometry.log_cos_h)
    return lobe["albedo"] * ((lobe["sharpness"] + 2) / (2 * pi) * fall)


def _lafortune(geometry: ShadingGeometry, lobe: Numbers) -> Tensor:
    """albedo (n + 2) / (2 pi) (max(0, Cxy (x_i x_o + y_i y_o) + Cz z_i z_o) / max(|Cxy|, |Cz|))^n."""
    upright = geometry.cos_i * geometry.cos_o
    flat = 2 * geometry.cos_d.square() - 1 - upright
    largest = torch.maximum(lobe["Cxy"].abs(), lobe["Cz"].abs())
    along = ((lobe["Cxy"] * flat + lobe["Cz"] * upright) / largest).clamp_min(0)
    return lobe["albedo"] * ((lobe["sharpness"] + 2) / (2 * pi) * along ** lobe["sharpness"])


def _low_smooth(geometry: ShadingGeometry, lobe: Numbers) -> Tensor:
    """A F (1 + B |p_i + p_o|^2)^-C of the projections p of the directions onto the surface [LKYU12, eqs. 10, 12, 14].

    F is at the angle whose squared sine is |p_i - p_o|^2 / 4.
    """
    across = 4 * geometry.cos_d.square() * geometry.sin2_h
    apart = 4 * (1 - geometry.cos_d.square()) - (geometry.cos_i - geometry.cos_o).square()
    f = dielectric((1 - apart / 4).clamp_min(0).sqrt(), lobe["eta"])
    return lobe["A"] * (f * (1 + lobe["B"] * across) ** -lobe["C"])


_WAVELENGTH = 0.55
"""Of the light under which He et al.'s model is evaluated, in the unit of the published lengths."""

_TERMS, _ROUGH = 120, 40.0
"""Terms of its series, and the g beyond which two terms of its expansion for rough surfaces stand for it."""


def _he(geometry: ShadingGeometry, lobe: Numbers) -> Tensor:
    """albedo F S G D / (pi cos theta_i cos theta_o), the directional-diffuse lobe of [HTSG91, eqs. 71, 76-84].

    D = (pi tau / (2 lambda))^2 sum_m g^m exp(-g - b / m) / (m! m), with b = (pi tau |p_i + p_o| / lambda)^2 of the
    projections p of the directions onto the surface, and g = (2 pi sigma (cos theta_i + cos theta_o) / lambda)^2 of
    the roughness that is seen, sigma = sigma_0 / sqrt(1 + x^2). S is the share that is neither shadowed nor masked,
    with the exponential that eq. 25 lacks in print; for an unpolarised lobe G is (|v|^2 / v_z)^2 of v = w_i + w_o.
    """
    sigma_0, tau = lobe["roughness"], lobe["autocorrelation"]
    shadowing, steepness = torch.ones_like(geometry.cos_i), torch.zeros_like(geometry.cos_i)
    for cosine in (geometry.cos_i, geometry.cos_o):
        cotangent = cosine / (1 - cosine.square()).clamp_min(1e-12).sqrt()
        slope = tau * cotangent / (2 * sigma_0)
        hidden = torch.erfc(slope)
        steepness = steepness + hidden / cotangent
        tail = torch.exp(-slope.square()) / (pi**0.5 * slope)
        shadowing = shadowing * (2 - hidden) / (2 + tail - hidden)
    # z of eq. 81 over sigma_0 is x, with x exp(x^2 / 2) = steepness / sqrt(8 pi): x^2 is Lambert's W.
    squared = torch.from_numpy(lambertw((steepness.square() / (8 * pi)).numpy()).real)
    sigma = sigma_0 / (1 + squared).sqrt()
    g = (2 * pi * sigma * (geometry.cos_i + geometry.cos_o) / _WAVELENGTH).square()
    b = (2 * pi * tau / _WAVELENGTH * geometry.cos_d).square() * geometry.sin2_h
    series, term = torch.zeros_like(g), torch.exp(-g)
    for m in range(1, _TERMS + 1):
        term = term * (g / m)
        series = series + term * torch.exp(-b / m) / m
    slope2 = b / g
    rough = torch.exp(-slope2) / g * (1 + (slope2.square() - 4 * slope2 + 2) / (2 * g))
    distribution = torch.where(g > _ROUGH, rough, series) * (pi * tau / (2 * _WAVELENGTH)) ** 2
    geometric = (2 * geometry.cos_d / geometry.cos_h).square()
    f = dielectric(geometry.cos_d, lobe["eta"])
    return lobe["albedo"] * (f * shadowing * geometric * distribution / (pi * geometry.cos_i * geometry.cos_o))


_SPECULAR, _ROUGHNESS, _ETA = ("albedo", "specular", 1.0), ("roughness", "roughness", 1.0), ("eta", "eta", 1.0)

_LOBES = {
    "NganWard": PublishedLobe("ward", (_SPECULAR, _ROUGHNESS)),
    "NganWardDuer": PublishedLobe("ward-duer", (_SPECULAR, _ROUGHNESS)),
    "NganCookTorrance": PublishedLobe(
        "cook-torrance", (("albedo", "specular", 4 / pi), ("eta", "f0", 1.0), _ROUGHNESS)
    ),
    "NganAshikhminShirley": PublishedLobe(
        "ashikhmin-shirley", (_SPECULAR, ("fresnelReflectance", "f0", 1.0), ("sharpness", "sharpness", 1.0))
    ),
    "NganBlinnPhong": PublishedLobe(None, f_r=_blinn_phong),
    "NganLafortune": PublishedLobe(None, f_r=_lafortune),
    "NganHe": PublishedLobe(None, f_r=_he),
    "LowCookTorrance": PublishedLobe(
        "cook-torrance-dielectric", (("albedo", "specular", 4.0), _ETA, _ROUGHNESS)
    ),
    "LowAshikhminShirley": PublishedLobe(
        "ashikhmin-shirley-dielectric",
        (_SPECULAR, ("fresnelReflectance", "eta", 1.0), ("sharpness", "sharpness", 1.0)),
    ),
    "LowMicrofacetFit": PublishedLobe(
        "low-microfacet", (("A", "amplitude", 1 / pi), ("B", "width", 1.0), ("C", "decay", 1.0), _ETA)
    ),
    "LowSmooth": PublishedLobe(None, f_r=_low_smooth),
}


@dataclass(frozen=True)
class PublishedFit:
    """One material in one file.

    lobe     name of the lobe
    diffuse  (3,) albedo of the Lambertian
    numbers  of the lobe

    Albedos are in the units of MERL, other numbers as published.
    """

    lobe: str
    diffuse: Tensor
    numbers: Numbers

    @property
    def model(self) -> str | None:
        """The model of `MODELS` that it is, if any."""
        return _LOBES[self.lobe].model

    @property
    def parameters(self) -> dict[str, Tensor]:
        """Those of `model`. Raises ValueError where there is none."""
        if self.model is None:
            raise ValueError(f"{self.lobe} is no model of torchbrdf: it has no parameters there, only f_r")
        renamed = _LOBES[self.lobe].renamed
        return {"diffuse": self.diffuse, **{ours: factor * self.numbers[theirs] for theirs, ours, factor in renamed}}

    def f_r(self, geometry: ShadingGeometry) -> Tensor:
        """f_r (N, 3) in 1/sr of N pairs of directions, 0 below the horizon."""
        if self.model is not None:
            return MODELS[self.model].evaluate(self.parameters, geometry)
        function = _LOBES[self.lobe].f_r
        assert function is not None
        return torch.where(geometry.above, self.diffuse / pi + function(geometry, self.numbers), 0)


def read_published(path: Path) -> dict[str, PublishedFit]:
    """Material -> fit, of a `.fit` file. Raises ValueError for another lobe, and for lines of any other form."""
    fits = {}
    for number, line in enumerate(path.read_text().splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        material, _, expression = line.partition(" = ")
        try:
            (diffuse_name, diffuse), (lobe, numbers) = map(_read_call, ast.parse(expression, mode="eval").body.args)  # type: ignore[attr-defined]
        except (SyntaxError, AttributeError, ValueError) as error:
            raise ValueError(f"{path}, line {number}: expected NAME = Aggregate(Lambertian(...), LOBE(...))") from error
        if diffuse_name != "Lambertian" or lobe not in _LOBES:
            raise ValueError(f"{path}, line {number}: no definition of {lobe}; there are {', '.join(_LOBES)}")
        fits[material] = _in_units_of_merl(PublishedFit(lobe, diffuse["albedo"], numbers))
    return fits


def _in_units_of_merl(fit: PublishedFit) -> PublishedFit:
    """With the factors of the colour channels that the fits of [NDM05] lack."""
    if not fit.lobe.startswith("Ngan"):
        return fit
    factors = torch.tensor(CHANNEL_SCALE, dtype=torch.float64) / CHANNEL_SCALE[0]
    numbers = {**fit.numbers, "albedo": fit.numbers["albedo"] * factors}
    return replace(fit, diffuse=fit.diffuse * factors, numbers=numbers)


def _read_call(call: ast.Call) -> tuple[str, Numbers]:
    """The name of what is called, and its keyword arguments."""
    arguments = {str(each.arg): ast.literal_eval(each.value) for each in call.keywords}
    numbers = {name: torch.tensor(value, dtype=torch.float64).reshape(-1) for name, value in arguments.items()}
    return call.func.id, numbers  # type: ignore[attr-defined]


def published_files(folder: Path = FITS) -> dict[str, Path]:
    """Stem -> path of the files."""
    return {path.stem: path for path in sorted(folder.glob("*.fit"))}
