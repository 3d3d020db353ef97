"""`Studio`: balls of a library's materials photographed, reconstructed without themselves and shown under other light.

Every picture is linear in the BRDF, so a material is a column of weights w over the whole library: one 1 a channel is
the material itself, and what was reconstructed has zeros where the material was left out. Pictures show B w as it is,
cells below zero and all: only then does one see what least squares found.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import pi, radians
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

import torchbrdf as tb
from leave_one_out import TARGET_SAMPLES
from paper.figures.light import Light
from torchbrdf.brdf import GRID, N_CELLS, above_horizon
from torchbrdf.experiments import BASELINES, Setting, noisy_observations
from torchbrdf.files import writing
from torchbrdf.lasting import LastFew
from torchbrdf.rendering import render_tables
from torchbrdf.transport import DEFAULT_SAMPLES

NAIVE, ONE_CLASS, _, PAPER, OURS = BASELINES
"""What the figures compare: |Y w - y| alone; lambda 0.5 with one class, with four; the default, penalty="auto"."""

_SUBPIXELS = 4
_ESTIMATORS = 4
_ROWS = 3
"""About one theta_d, either way: a lookup touches two, and at the horizon neighbours that fill in."""


@dataclass(frozen=True)
class Quality:
    """How balls are photographed and shown.

    size     pixels along a side of the photographs that the estimator gets
    tile     pixels along a side of the pictures
    samples  a pixel of the sampled transport; None for the harmonic one, which shows no noise
    noise    of the photographs, in per cent of every pixel
    """

    size: int = 64
    tile: int = 128
    samples: int | None = None
    noise: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not 0 <= self.noise < float("inf"):
            raise ValueError(f"noise must be a percentage of at least 0, got {self.noise}")
        if self.samples is not None and self.samples < 2:
            raise ValueError(f"samples must be at least 2, got {self.samples}")


def stored(path: Path, settings: Mapping[str, object], make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """The tensors of a file that was made with the same settings; else they are made now and written, whole."""
    wanted = json.dumps(settings, sort_keys=True, default=str)
    try:
        with safe_open(path, "pt") as file:
            if (file.metadata() or {}).get("settings") == wanted:
                return {key: file.get_tensor(key) for key in list(file.keys())}
    except (FileNotFoundError, SafetensorError):
        pass
    made = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    with writing(path) as temporary:
        save_file({key: tensor.contiguous() for key, tensor in made.items()}, temporary, {"settings": wanted})
    return made


class Studio:
    """A library, how balls are shown, and a folder where what takes long is kept."""

    def __init__(self, library: tb.MaterialLibrary, quality: Quality, folder: Path) -> None:
        """Check the sizes."""
        self.library, self.quality, self.folder = library, quality, folder
        self.photographed, self.shown = tb.SphereView(quality.size), tb.SphereView(quality.tile)
        self._bases: dict[tuple[str, str], tb.BasisImages] = {}
        self._classes: dict[tuple[tuple[str, ...], str], tb.MaterialClasses] = {}
        self._estimators: LastFew[tuple[tuple[str, ...], str, str], tb.BRDFEstimator] = LastFew(_ESTIMATORS)

    def basis(self, probe: tb.LightProbe, view: tb.SphereView) -> tb.BasisImages:
        """Of the whole library, made once."""
        key = probe.fingerprint, view.fingerprint
        if key not in self._bases:
            samples = self.quality.samples
            backend = "harmonic" if samples is None else "sampled"
            self._bases[key] = tb.render_basis(self.library, probe, view, backend, samples, progress=True)
        return self._bases[key]

    def photographs(self, materials: Sequence[str], probe: tb.LightProbe) -> dict[str, Tensor]:
        """(3, N, N) of each material under a probe, with noise, rendered with other random numbers than any basis."""
        samples = TARGET_SAMPLES * (self.quality.samples or DEFAULT_SAMPLES)
        settings = self.facts(probe=probe.fingerprint, materials=list(materials), samples=samples)

        def make() -> dict[str, Tensor]:
            tables = [self.library.table(name) for name in materials]
            images = render_tables(tables, probe, self.photographed, samples, seed=self.quality.seed + 1)
            return dict(zip(materials, images, strict=True))

        key = hashlib.sha256(" ".join(materials).encode()).hexdigest()[:8]
        clean = stored(self.folder / f"photographs-{_short(probe)}-{key}.safetensors", settings, make)
        noise = self.quality.noise
        return {name: self.noisy(clean[name], f"{name} {probe.fingerprint}", noise) for name in materials}

    def noisy(self, image: Tensor, key: str, percent: float) -> Tensor:
        """An image (3, N, N), every pixel and channel with noise that depends on the key and the seed only."""
        return noisy_observations(image, [percent], f"{self.quality.seed} {key}")[0].float()

    def estimator(self, library: tb.MaterialLibrary, probe: tb.LightProbe, setting: Setting) -> tb.BRDFEstimator:
        """Of photographs under a probe as the user has it; the last few are kept."""
        key = library.names, probe.fingerprint, repr(setting.arguments)

        def made() -> tb.BRDFEstimator:
            grouping = library.names, repr(setting.classes)
            if grouping not in self._classes:
                self._classes[grouping] = tb.MaterialClasses.fit(library, **setting.classes)
            basis = self.basis(probe, self.photographed).subset(library.names)
            return tb.BRDFEstimator(basis, self._classes[grouping], **setting.estimator)

        return self._estimators.get_or_make(key, made)

    def weights(self, found: Tensor, names: Sequence[str]) -> Tensor:
        """(n, 3) float64 over the whole library, of weights (3 len(names), 3) over some of its materials."""
        whole = torch.zeros(self.library.n, 3, dtype=torch.float64)
        for i, name in enumerate(names):
            position = self.library.position(name)
            whole[3 * position : 3 * position + 3] = found[3 * i : 3 * i + 3].double()
        return whole

    def itself(self, material: str) -> Tensor:
        """(n, 3): the weights of a material of the library."""
        return self.weights(torch.eye(3), [material])

    def under(self, weights: Sequence[Tensor], light: Light) -> list[Tensor]:
        """(3, T, T) of a ball a weights (n, 3); a directional light gives a white Lambertian surface at most 1."""
        columns = torch.stack([one.float() for one in weights])
        if isinstance(light.source, int):
            return self._lit(columns, light.source)
        return list(self.basis(light.source, self.shown).render(columns))

    def _lit(self, weights: Tensor, angle_deg: int) -> list[Tensor]:
        """View and light are parallel everywhere, so theta_d is half the light's angle on the whole ball.

        Of the tables only the rows about it are filled.
        """
        row = int(radians(angle_deg) / 2 * (GRID[1] * 2 / pi))
        low, high = max(0, row - _ROWS), min(GRID[1], row + _ROWS + 1)
        cells = torch.arange(N_CELLS).view(GRID)[:, low:high]
        f_r = self.library.rows(cells.flatten()) @ weights.permute(1, 0, 2).flatten(1)
        images = []
        for one in f_r.view(*cells.shape, -1, 3).unbind(3):
            values = torch.zeros(*GRID, 3)
            values[:, low:high] = one
            table = tb.MerlTable(values, above_horizon(), "combination")
            images.append(
                tb.render_directional(table, self.shown, angle_deg, irradiance=pi, subpixels=_SUBPIXELS)
            )
        return images

    def facts(self, **others: object) -> dict[str, object]:
        """What a stored result depends on."""
        return {"library": self.library.source, "version": tb.__version__, **asdict(self.quality), **others}


def _short(probe: tb.LightProbe) -> str:
    return probe.fingerprint[:12]
