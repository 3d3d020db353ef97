"""What a light and a view can tell about a material, before any photograph is taken."""

from dataclasses import dataclass
from math import degrees, pi
from typing import Literal

import torch
from torch import Tensor

from torchbrdf.arguments import check_types
from torchbrdf.brdf import GRID, MaterialLibrary, above_horizon, cell_centres
from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.estimation.priors import PriorBank, whole_variances
from torchbrdf.estimation.rehearsal import Rehearsal

Gap = Literal["gloss", "shadow", "grazing"]

CANNOT = 0.3
"""Share of the highlight's variance removed below which a light cannot tell gloss from albedo."""

HARDLY = 0.45
"""And below which it hardly can. Uniform light removes 0.1, a vertical gradient 0.2, measured probes 0.42 to 0.65; the
error under other light at what lies between: docs/uncertainty.md."""

NEAR = 0.05
"""From HARDLY, within which the verdict says partly: lights on both sides of it are alike."""

GRAZING = 0.78
"""Mean share of what is open about grazing reflection below which the verdict says that it will be a guess. Lights from
all sides have 0.8 to 0.9, one window behind the camera 0.77, one lamp beside it 0.65."""

SHADOWED = 0.25
"""Share of the pixels without light above which the verdict says so: one slice of the BRDF is no whole, whatever the
library makes of it. Measured probes leave none dark, one lamp behind the object 0.7."""

_MIRRORED, _GRAZES = 15, 60
"""theta_h below which, and theta_d from which on, in degrees, reflection counts as mirror-like at grazing angles."""

_DARK = 0.05
"""Of a pixel's weighted mean basis image, which is 0.77 at the mean radiance and below 1."""

PHI_D = 90
"""phi_d in degrees of the cells shown."""

_STEP = 5
"""Every fifth cell along theta_h and theta_d is shown."""

_POWERS = (0.0, 0.5)
"""The whole library as it is, and with S = 1 / |b_i|, so that the few BRDFs with high peaks do not decide alone."""


@dataclass(frozen=True, eq=False, repr=False)
class Observability:
    """What photographs under this light from this view determine, at a stated noise, if materials are like the library.

    Materials are taken as drawn from the library: weights of second moment diag(S) / n, see `priors`.

    noise      standard deviation of a pixel's error, in units of the weighted photograph's root mean square
    freedom    (K,)  effective degrees of freedom of each class: how many numbers about the material stand out of the
               noise, per colour channel; mean over the channels in which there is light
    whole      the same of the whole library
    highlight  0 ... 1: share removed by the photograph of what is open, at a given brightness of the photograph, about
               |f_r|, which the highlight rules
    dark       0 ... 1: share of the pixels that no light reaches
    seen       (18, 18)  the share removed for single cells of the BRDF at phi_d = 90 degrees, rows theta_h, columns
               theta_d; NaN below the horizon; None without a library
    theta_h, theta_d  (18,)  degrees of these
    rehearsal  errors of the library's own materials under other light; None where none was given
    """

    noise: float
    freedom: Tensor
    whole: float
    highlight: float
    dark: float
    seen: Tensor | None
    theta_h: Tensor
    theta_d: Tensor
    rehearsal: Rehearsal | None = None

    def __repr__(self) -> str:
        """The verdict."""
        return f"Observability({self.verdict})"

    @property
    def predicted_error(self) -> float | None:
        """Relative RMS error to expect of pictures under other light, mean over materials; None without a rehearsal."""
        return None if self.rehearsal is None else self.rehearsal.error

    @property
    def grazing(self) -> float | None:
        """0 ... 1: share removed of what is open about mirror-like reflection at grazing angles; None without cells."""
        if self.seen is None:
            return None
        cells = self.seen[self.theta_h < _MIRRORED][:, self.theta_d >= _GRAZES]
        return float(cells.nanmean())

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """What this light leaves open whatever the photograph is, the worst first."""
        found: list[Gap] = []
        if self.whole == 0 or self.highlight < HARDLY:
            found.append("gloss")
        if self.dark > SHADOWED:
            found.append("shadow")
        if self.grazing is not None and self.grazing < GRAZING:
            found.append("grazing")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """One line."""
        if self.rehearsal is None:
            return self._told
        kinds = ", ".join(f"{kind} {100 * error:.0f}" for kind, error in self.rehearsal.by_kind.items())
        return f"{self._told}; expect an error of {100 * self.rehearsal.error:.0f} % under other light ({kinds})"

    @property
    def _told(self) -> str:
        if self.whole == 0:
            return "no light on the object: tells nothing"
        numbers = f"about {self.whole:.0f} numbers a channel stand out of {self.noise:.1%} noise"
        if "shadow" in self.gaps:
            numbers += f"; {self.dark:.0%} of the picture lies in shadow: light from more sides"
        share = f"removes {self.highlight:.0%} of what is open about the highlight"
        if self.highlight < CANNOT:
            return f"cannot tell gloss from albedo: {share}; {numbers}; use light with edges or small bright lamps"
        if "grazing" in self.gaps:
            share = f"no light from behind the object: grazing reflection will be a guess from this side alone; {share}"
        tells = "partly tells" if abs(self.highlight - HARDLY) < NEAR else "tells"
        if "gloss" in self.gaps:
            tells = "hardly tells" if tells == "tells" else tells
            return f"{tells} gloss from albedo: {share}; {numbers}; brighter lamps on more sides would help"
        but = " where light falls" if "shadow" in self.gaps else ""
        return f"{tells} gloss from albedo{but}: {share}; {numbers}"


def observability(
    bank: PriorBank, classes: MaterialClasses, library: MaterialLibrary | None = None, noise: float = 0.01
) -> Observability:
    """What the light and view behind a bank of priors can tell.

    With K = R diag(S) R^T / n, the covariance of weighted photographs, whitened, eigenvalues e and noise s^2, there
    are sum e / (e + s^2) degrees of freedom, and a photograph removes the share
    |V^T R S b / sqrt(e + s^2)|^2 / (n b S b^T) of the variance of b w. Pixels' errors are not independent: s^2 counts
    `independent_pixels` only. What is removed may be seen, or known from what is seen because the library's materials
    go together: a cell can be determined that no light reaches. `highlight` is that share for b_i = |b_i|, less its
    regression on how bright the basis images are.

    library  the one behind the bank, for `seen`
    noise    of a pixel, relative to the weighted photograph
    Raises ValueError for another library, and noise that is not above 0.
    """
    if not 0 < noise < float("inf"):
        raise ValueError(f"noise must be above 0, a share of the photograph such as 0.01, got {noise}")
    if library is not None:
        check_types("BRDFEstimator.observability", library=(library, MaterialLibrary))
        if (library.source, library.names) != (classes.library, classes.names):
            raise ValueError("this library is not the one that the basis images were rendered with")
    space, k = bank.space, classes.n_classes
    norms = classes.norms.to(bank.variances)
    whole = PriorBank.of(space, torch.stack([whole_variances(norms, power) for power in _POWERS]))
    variances, values = torch.cat([bank.variances[:k], whole.variances]), torch.cat([bank.values[:k], whole.values])
    floor = noise**2 / bank.independent_pixels * (variances @ space.r.square().sum(1).mT)[..., None]
    lit = (floor[k, :, 0] > 0).to(floor)
    share = lit / lit.sum().clamp_min(1)
    spectrum = _positive(values + floor)
    freedom = ((values / spectrum).sum(-1) * share).sum(-1)

    even = whole.variances[1]
    directions = even[:, None] * (space.white.mT @ whole.vectors[1])
    weighted = directions / spectrum[k + 1].sqrt()[:, None]

    def removed(rows: Tensor) -> Tensor:
        before = (rows.square() @ even).expand(3, -1)
        after = (rows @ weighted).square().sum(-1)
        return (torch.where(before > 0, after / torch.where(before > 0, before, 1), 1) * share[:, None]).sum(0)

    size = 1 / even  # |b_i|, up to a factor
    brightness = (space.r.mT @ space.r.mean(-1, keepdim=True))[..., 0]
    common = (brightness * even * size).sum(-1) / _positive((brightness.square() * even).sum(-1))
    highlight = float(removed((size - common[:, None] * brightness)[:, None])[0])

    mean_image = (space.u.to(even) @ space.r.mean(-1, keepdim=True))[..., 0]
    dark = float(((mean_image < _DARK).to(even).mean(-1) * share).sum())

    theta_h, theta_d, phi_d = cell_centres()
    h, d = (torch.arange(_STEP // 2, size, _STEP) for size in GRID[:2])
    seen = None
    if library is not None:
        p = int((phi_d - PHI_D * pi / 180).abs().argmin())
        cells = ((h[:, None] * GRID[1] + d) * GRID[2] + p).ravel()
        shares = removed(library.rows(cells, keep=False).to(even))
        seen = torch.where(above_horizon().ravel()[cells], shares.cpu(), torch.nan).reshape(len(h), len(d))
    return Observability(
        noise=noise,
        freedom=freedom[:k].cpu(),
        whole=float(freedom[k]),
        highlight=highlight,
        dark=dark,
        seen=seen,
        theta_h=theta_h.ravel()[h] * degrees(1),
        theta_d=theta_d.ravel()[d] * degrees(1),
    )


def _positive(x: Tensor) -> Tensor:
    """A divisor: 1 where x is 0."""
    return torch.where(x > 0, x, 1)
