"""Inputs on which numerical code likes to break: small synthetic scenes, each with one thing wrong with it.

`CASES` feeds tests/estimation/test_stability.py; run as a script it prints the measured table of
docs/results/stability.md.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import pi
from typing import Any

import torch
from torch import Tensor

from torchbrdf.estimation.classes import MaterialClasses, Mixture
from torchbrdf.transport.basis_images import BasisImages

N_MATERIALS = 12
LABELS = tuple(j for i in range(N_MATERIALS) for j in ((0, 0, 1), (1, 1, 1), (2, 0, 0))[i % 3])
"""Classes of 16, 16 and 4 of the 36 basis BRDFs, interleaved."""


@dataclass(frozen=True)
class Light:
    """Directional lights (L, 3) of colours (L, 3), and the same radiance (3,) from everywhere."""

    directions: Tensor
    colours: Tensor
    ambient: Tensor


def light(*lamps: tuple[tuple[float, float, float], float], ambient: float = 0.3) -> Light:
    """Slightly coloured lamps of ((x, y, z), irradiance)."""
    tint = torch.tensor([[1.0, 0.9, 0.8], [0.8, 0.95, 1.0], [1.0, 1.0, 0.9]]).double()
    directions = torch.tensor([direction for direction, _ in lamps]).double().reshape(-1, 3)
    strengths = torch.tensor([strength for _, strength in lamps]).double().reshape(-1, 1)
    return Light(
        torch.nn.functional.normalize(directions, dim=-1),
        strengths * tint[torch.arange(len(lamps)) % 3],
        ambient * torch.tensor([0.9, 1.0, 1.1]).double(),
    )


STUDIO = light(((0.6, 0.5, 0.6), 3.0), ((-0.8, 0.1, 0.5), 1.0), ((0.1, -0.9, -0.2), 0.5))


@dataclass(frozen=True)
class Materials:
    """albedo (m, 3), specular (m, 3), exponent (m,) of the lobe."""

    albedo: Tensor
    specular: Tensor
    exponent: Tensor


def materials(m: int, seed: int) -> Materials:
    """From matte to mirror-like; every third a metal, without a diffuse part."""
    g = torch.Generator().manual_seed(seed)
    albedo, specular, shift = (torch.rand(m, k, generator=g, dtype=torch.float64) for k in (3, 3, 1))
    metal = (torch.arange(m) % 3 == 2)[:, None]
    exponent = 10 ** (3 * (torch.arange(m) + shift[:, 0]) / m)
    return Materials(
        torch.where(metal, 0.005, 0.02 + 0.8 * albedo),
        torch.where(metal, 0.3 + 0.6 * specular, 0.04 + 0.02 * specular),
        exponent[torch.randperm(m, generator=g)],
    )


def sphere(size: int) -> tuple[Tensor, Tensor]:
    """The mask (1, size, size) of a sphere and the normals (P, 3) of its pixels."""
    centre = (2 * torch.arange(size).double() + 1) / size - 1
    y, x = torch.meshgrid(-centre, centre, indexing="ij")
    mask = x**2 + y**2 < 0.97
    z = torch.sqrt(1 - x[mask] ** 2 - y[mask] ** 2)
    return mask[None], torch.stack([x[mask], y[mask], z], -1)


def shade(normals: Tensor, lit: Light, shiny: Materials) -> Tensor:
    """(m, 3, 3, P): material, its channel, channel of the light, pixel."""
    view = torch.tensor([0.0, 0.0, 1.0]).double()
    half = torch.nn.functional.normalize(lit.directions + view, dim=-1)
    cosine = (normals @ lit.directions.T).clamp_min(0)
    lobes = (normals @ half.T).clamp_min(0) ** shiny.exponent[:, None, None] * (shiny.exponent[:, None, None] + 2) / 8
    diffuse = lit.ambient[:, None] + (cosine @ lit.colours).T / pi
    rim = 0.5 + 0.5 * (1 - normals[:, 2]) ** 5
    gloss = lit.ambient[:, None] * rim + ((lobes * (cosine > 0)) @ lit.colours).mT
    return shiny.albedo[:, :, None, None] * diffuse + shiny.specular[:, :, None, None] * gloss[:, None]


def synthetic(lit: Light = STUDIO, size: int = 14, m: int = N_MATERIALS, seed: int = 0) -> BasisImages:
    """Basis images of m materials on a ball: positive, strongly correlated, with highlights."""
    mask, normals = sphere(size)
    packed = shade(normals, lit, materials(m, seed)).flatten(0, 1).float()
    return BasisImages(packed, mask, tuple(f"m{i}" for i in range(m)), "L", probe="P", view="V")


def photograph(lit: Light = STUDIO, size: int = 14, noise: float = 0.01, count: int = 1, seed: int = 7) -> Tensor:
    """(count, 3, size, size) of materials that the library does not hold, with noise."""
    mask, normals = sphere(size)
    shaded = shade(normals, lit, materials(count, seed))
    image = torch.stack([shaded[:, s, s] for s in range(3)], 1)
    g = torch.Generator().manual_seed(seed + 1)
    image = image + noise * image.mean(-1, keepdim=True) * torch.randn(image.shape, generator=g, dtype=torch.float64)
    full = torch.zeros(count, 3, size, size, dtype=torch.float64)
    full[..., mask[0]] = image
    return full


def classes_of(labels: tuple[int, ...] = LABELS, library: str = "L") -> MaterialClasses:
    """Classes with these labels, well apart in two dimensions."""
    responsibilities = torch.nn.functional.one_hot(torch.tensor(labels)).double()
    k = responsibilities.shape[1]
    mixture = Mixture(
        mixing=responsibilities.mean(0),
        means=torch.stack([torch.arange(k), torch.ones(k)], -1).double(),
        covariances=0.01 * torch.eye(2).double().repeat(k, 1, 1),
        responsibilities=responsibilities,
        history=(0.0,),
        converged=True,
    )
    return MaterialClasses(mixture, [f"m{i}" for i in range(len(labels) // 3)], library)


@dataclass(frozen=True)
class Case:
    """What one call of the estimator gets; image (3, H, W) float64, mask (1, H, W) or None."""

    basis: BasisImages
    classes: MaterialClasses
    image: Tensor
    mask: Tensor | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


CASES: dict[str, Callable[[], Case]] = {}


def listed(make: Callable[[], Case]) -> Callable[[], Case]:
    """Add a case to `CASES`, under its own name."""
    CASES[make.__name__] = make
    return make


def _case(lit: Light = STUDIO, size: int = 14) -> Case:
    return Case(synthetic(lit, size), classes_of(), photograph(lit, size)[0])


@listed
def ordinary() -> Case:
    """Nothing wrong."""
    return _case()


def _with_columns(change: Callable[[Tensor], Tensor]) -> Case:
    """The columns 18 to 35 made from the first 18."""
    case = _case()
    packed = case.basis.packed.double()
    packed = torch.cat([packed[:18], change(packed[:18])])
    return replace(case, basis=replace(case.basis, packed=packed))


@listed
def duplicates() -> Case:
    return _with_columns(lambda columns: columns)


@listed
def near_duplicates() -> Case:
    g = torch.Generator().manual_seed(3)
    return _with_columns(
        lambda columns: columns * (1 + 1e-7 * torch.randn(columns.shape, generator=g, dtype=torch.float64))
    )


@listed
def proportional() -> Case:
    return _with_columns(lambda columns: 1000 * columns)


@listed
def black_columns() -> Case:
    return _with_columns(lambda columns: torch.zeros_like(columns))


@listed
def black_class() -> Case:
    """One class whose members all are black under this light."""
    case = _case()
    packed = case.basis.packed.clone()
    packed[case.classes.members(2)] = 0
    return replace(case, basis=replace(case.basis, packed=packed))


@listed
def black_basis() -> Case:
    """Every basis image is black: nothing explains the photograph."""
    case = _case()
    return replace(case, basis=replace(case.basis, packed=torch.zeros_like(case.basis.packed)))


@listed
def small_classes() -> Case:
    """Classes of one, two and 33 members."""
    return replace(_case(), classes=classes_of((0, 1, 1) + (2,) * 33))


@listed
def one_member_each() -> Case:
    """Three basis BRDFs, each a class."""
    case = _case()
    return replace(case, basis=case.basis.subset(["m4"]), classes=_named(classes_of((0, 1, 2)), ("m4",)))


def _named(classes: MaterialClasses, names: tuple[str, ...]) -> MaterialClasses:
    classes.names = names
    return classes


@listed
def one_class() -> Case:
    """36 columns in one class."""
    return replace(_case(), classes=classes_of((0,) * 36))


@listed
def ten_pixels() -> Case:
    """Ten pixels, classes of 16, 16 and 4."""
    case = _case()
    kept = torch.zeros_like(case.basis.mask)
    kept.view(-1)[torch.nonzero(case.basis.mask.ravel()).ravel()[5::15][:10]] = True
    packed = case.basis.packed[..., case.basis.pack(kept)[0]]
    return replace(case, basis=replace(case.basis, packed=packed, mask=kept))


@listed
def one_pixel() -> Case:
    case = _case()
    kept = torch.zeros_like(case.basis.mask)
    kept[0, 7, 7] = True
    packed = case.basis.packed[..., case.basis.pack(kept)[0]]
    return replace(case, basis=replace(case.basis, packed=packed, mask=kept))


@listed
def as_many_pixels_as_columns() -> Case:
    """One class of 36 columns, 36 pixels."""
    case = replace(_case(), classes=classes_of((0,) * 36))
    return replace(case, mask=_mask_of(case.basis.mask, 36))


def _mask_of(view: Tensor, pixels: int) -> Tensor:
    mask = torch.zeros_like(view)
    chosen = torch.nonzero(view.ravel()).ravel()
    chosen = chosen[torch.linspace(0, len(chosen) - 1, pixels).long()]
    mask.view(-1)[chosen] = True
    return mask


@listed
def one_percent() -> Case:
    """8 of 788 pixels."""
    case = _case(size=32)
    return replace(case, mask=_mask_of(case.basis.mask, round(0.01 * int(case.basis.mask.sum()))))


@listed
def masked_to_one_pixel() -> Case:
    case = _case()
    return replace(case, mask=_mask_of(case.basis.mask, 1))


@listed
def uniform_light() -> Case:
    return _case(light(ambient=1.0))


@listed
def one_texel() -> Case:
    """One lamp from the side, black surroundings: 38 % of the pixels are black in every column."""
    return _case(light(((0.9, 0.1, 0.2), 3.0), ambient=0.0))


@listed
def sun() -> Case:
    """A lamp 1e6 times as bright as the surroundings; more than half of the ball does not see it."""
    return _case(light(((0.9, 0.3, -0.1), 1e6), ambient=1.0))


@listed
def back_light() -> Case:
    """A lamp nearly behind the ball: a few pixels are 1e6 times as bright as the others."""
    return _case(light(((0.3, 0.2, -0.9), 1e6), ambient=1.0))


@listed
def coloured_light() -> Case:
    """Red light only: the basis images and the photograph are black in green and blue."""
    red = torch.tensor([1.0, 0, 0]).double()
    return _case(replace(STUDIO, colours=STUDIO.colours * red, ambient=0.3 * red))


@listed
def coloured_light_in_the_basis_only() -> Case:
    """Basis images black in blue, where the photograph is not."""
    case = _case()
    packed = case.basis.packed.clone()
    packed[:, 2] = 0
    return replace(case, basis=replace(case.basis, packed=packed))


def _spoilt(spoil: Callable[[Tensor], Tensor], **options: Any) -> Case:
    case = _case()
    return replace(case, image=spoil(case.image), options=options)


def _saturate(image: Tensor) -> Tensor:
    """The brightest 2 % of the values cut off."""
    inside = image[image > 0]
    return image.clamp_max(float(inside.quantile(0.98)))


def _some_pixels(image: Tensor, value: float) -> Tensor:
    """Five pixels, 3 %, at a value times the brightest."""
    spoilt = image.clone()
    inside = torch.nonzero((image[0] != 0).ravel()).ravel()
    spoilt.flatten(1)[:, inside[3::31]] = value * image.max()
    return spoilt


@listed
def saturated() -> Case:
    return _spoilt(_saturate)


@listed
def dead_pixels() -> Case:
    return _spoilt(lambda image: _some_pixels(image, 0.0))


@listed
def hot_pixels() -> Case:
    return _spoilt(lambda image: _some_pixels(image, 20.0))


@listed
def one_extreme_pixel() -> Case:
    """One pixel 1e6 times the brightest."""

    def spoil(image: Tensor) -> Tensor:
        image = image.clone()
        image[:, 5, 6] = 1e6 * image.max()
        return image

    return _spoilt(spoil)


@listed
def black_channel() -> Case:
    return _spoilt(lambda image: image * torch.tensor([1.0, 0.0, 1.0]).view(3, 1, 1))


@listed
def two_black_channels() -> Case:
    return _spoilt(lambda image: image * torch.tensor([0.0, 0.0, 1.0]).view(3, 1, 1))


@listed
def one_pixel_not_black() -> Case:
    """Black but for one value of one channel."""

    def spoil(image: Tensor) -> Tensor:
        dark = torch.zeros_like(image)
        dark[1, 6, 8] = image[1, 6, 8]
        return dark

    return _spoilt(spoil)


@listed
def negative_channel() -> Case:
    """A photograph from which too much was subtracted: the blue mean is below zero."""
    return _spoilt(lambda image: image - torch.tensor([0.0, 0.2, 3.0]).view(3, 1, 1) * image.mean())


@listed
def zero_mean() -> Case:
    """Nothing but noise: positive and negative values that cancel."""

    def spoil(image: Tensor) -> Tensor:
        inside = image[0] != 0
        noise = torch.randn(3, int(inside.sum()), generator=torch.Generator().manual_seed(4), dtype=torch.float64)
        dark = torch.zeros_like(image)
        dark[:, inside] = noise - noise.mean(-1, keepdim=True)
        return dark

    return _spoilt(spoil)


@listed
def constant() -> Case:
    """The same value everywhere."""
    return _spoilt(lambda image: torch.full_like(image, 0.5))


@listed
def in_the_library() -> Case:
    """Basis image 9 itself, without noise: a residual of 0."""
    case = _case()
    return replace(case, image=case.basis.unpack(case.basis.packed[9].double()))


@listed
def mean_of_a_class() -> Case:
    """Y mu' of class 1: residual and distance to the prior are both 0."""
    case = _case()
    members = case.classes.members(1)
    return replace(case, image=case.basis.unpack(case.basis.packed[members].double().mean(0)))


@listed
def in_the_span() -> Case:
    """A combination of the columns of class 0, with negative weights, without noise."""
    case = _case()
    members = case.classes.members(0)
    w = torch.randn(len(members), 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return replace(case, image=case.basis.unpack(torch.einsum("ns,nsp->sp", w, case.basis.packed[members].double())))


@listed
def lit_where_the_basis_is_black() -> Case:
    """The photograph has light in pixels that no basis image can explain."""
    case = one_texel()
    return replace(case, image=photograph()[0])


@listed
def other_exposure() -> Case:
    """A photograph 1e4 times too bright for its probe."""
    return _spoilt(lambda image: 1e4 * image)


def main() -> None:
    """The table of docs/results/stability.md: how each case ends with the default and with the paper's penalty."""
    import inspect

    from torchbrdf.estimation.estimator import BRDFEstimator

    default = inspect.signature(BRDFEstimator).parameters["penalty"].default

    def solved(case: Case, scale: float = 1.0, **options: Any) -> tuple[Tensor, float]:
        basis = replace(case.basis, packed=case.basis.packed * scale)
        result = BRDFEstimator(basis, case.classes, **options)(case.image * scale, case.mask)
        return result.weights, float(result.relative_error)

    def change(before: Tensor, after: Tensor) -> float:
        return float((after - before).abs().max() / before.abs().max().clamp_min(1e-300))

    print(f"| case | error, {default} | error, paper | weights, {default} | weights, paper | times 2^26 | times 1e8 |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name, make in CASES.items():
        case = make()
        weights, error = solved(case)
        paper, paper_error = solved(case, penalty="paper")
        powers, decimal = (change(weights, solved(case, scale)[0]) for scale in (2.0**26, 1e8))
        print(
            f"| {name.replace('_', ' ')} | {error:.4f} | {paper_error:.4f} "
            f"| {float(weights.norm()):.2f} | {float(paper.norm()):.2f} | {powers:.0e} | {decimal:.0e} |"
        )


if __name__ == "__main__":
    main()
