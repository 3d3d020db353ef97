"""What both versions get: probes, photographs of materials that no library holds, tables; made once in a folder."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from speed.settings import HALF_AROUND, PROBES, SIZE, TABLES
from torchbrdf.experiments import SHARED, open_probes, tilt
from torchbrdf.files import replacing_folder
from torchbrdf.transport import render_columns

PHOTOGRAPHS, NOISE = 100, 0.01
TURNS = {"near": tilt(4.0), "full": tilt(4.0) @ torch.diag(torch.tensor([-1.0, 1.0, -1.0], dtype=torch.float64))}
"""By what the light of a photograph for `align` is turned."""

_OTHER_LIGHT = torch.diag(torch.tensor(HALF_AROUND))
_SAMPLES, _TOGETHER = 4096, 20
_LAMPS = ((20, 30, 1.2), (60, 80, 0.8), (80, 200, 1.5), (50, 300, 1.0))
"""Of the probe "lamps": degrees from the zenith, azimuth, radius."""

_LAMP, _LAMP_COLOUR = 3.5, torch.tensor([1.0, 0.9, 0.7])[:, None, None]
"""Radiance of a lamp that fills a hemisphere."""

_RECIPE = 1
"""Changes with what this module makes."""


@dataclass(frozen=True)
class Inputs:
    """The files.

    probes       by name, lat-long .exr, which every version reads alike
    tables       by the keys of TABLES, .binary
    photographs  .exr, under the probe "default", of geometric means of two materials each
    """

    folder: Path

    @classmethod
    def of(cls, folder: Path) -> "Inputs":
        """Those in a folder, made first where they are not there."""
        made = folder / f"inputs-{_RECIPE}"
        if not made.is_dir():
            with replacing_folder(made, "choose another --folder") as temporary:
                _make(temporary)
        return cls(made)

    @property
    def probes(self) -> dict[str, Path]:
        """See the class."""
        return {name: path for name in PROBES if (path := self.folder / f"{name}.exr").is_file()}

    @property
    def tables(self) -> dict[str, Path]:
        """See the class."""
        return {name: self.folder / f"{name}.binary" for name in TABLES}

    @property
    def photographs(self) -> list[Path]:
        """See the class."""
        return sorted((self.folder / "photographs").iterdir())

    @property
    def novel_probe(self) -> tb.LightProbe:
        """The light under which reconstructions are judged."""
        return tb.LightProbe.open(self.probes["default"]).rotated(_OTHER_LIGHT)

    def tensor(self, name: str) -> Tensor:
        """photographs and novel (100, 3, 64, 64): noisy, and without noise under `novel_probe`; near and full
        (3, 64, 64): under turned probes."""
        found: Tensor = torch.load(self.folder / f"{name}.pt")
        return found


def _make(folder: Path) -> None:
    library = tb.MaterialLibrary.default()
    probes = {"default": tb.LightProbe.default(), "smooth": tb.LightProbe.sky(40.0, sun=False), "lamps": lamps()}
    if (grace := SHARED / "probes" / "grace.hdr").is_file():
        probes |= open_probes([grace])
    for name, probe in probes.items():
        probe.save(folder / f"{name}.exr")
    for name, material in TABLES.items():
        library.table(material).save(folder / f"{name}.binary")
    view, light = tb.SphereView(SIZE), probes["default"]
    lights = {"photographs": light, "novel": light.rotated(_OTHER_LIGHT)}
    images: dict[str, list[Tensor]] = {name: [] for name in lights}
    for start in tqdm(range(0, PHOTOGRAPHS, _TOGETHER), "photographs of the benchmark", leave=False):
        values = torch.cat([between(library, i) for i in range(start, start + _TOGETHER)], 1)
        for name, probe in lights.items():
            images[name].append(images_of(values, probe, view))
    clean = torch.cat(images["photographs"])
    noise = torch.randn(clean.shape, generator=torch.Generator().manual_seed(0))
    photographs = clean * (1 + NOISE * noise)
    torch.save(photographs, folder / "photographs.pt")
    torch.save(torch.cat(images["novel"]), folder / "novel.pt")
    for name, turn in TURNS.items():
        image = images_of(between(library, 0), light.rotated(turn), view)[0]
        torch.save(image * (1 + NOISE * noise[0]), folder / f"{name}.pt")
    (folder / "photographs").mkdir()
    for i, image in enumerate(photographs):
        tb.write_image(folder / "photographs" / f"ball{i:03}.exr", image)


def between(library: tb.MaterialLibrary, i: int) -> Tensor:
    """(cells, 3) of a material that no combination of columns gives: the geometric mean of two."""
    places = (i % len(library), (7 * i + 3) % len(library))
    first, second = (library.table(library.names[place]) for place in places)
    return (first.filled.clamp_min(0) * second.filled.clamp_min(0)).sqrt().float()


def images_of(values: Tensor, probe: tb.LightProbe, view: tb.View, samples: int = _SAMPLES, seed: int = 1) -> Tensor:
    """(K, 3, H, W): tables, (cells, 3 K), by the sampled transport."""
    packed = render_columns(values, probe, view, samples, seed).unflatten(2, (-1, 3))
    return view.unpack(torch.einsum("cpkc->kcp", packed))


def lamps(height: int = 256) -> tb.LightProbe:
    """Four small lamps, with nine tenths of the power, in a dim room."""
    theta = (torch.arange(height) + 0.5) * (torch.pi / height)
    phi = (torch.arange(2 * height) + 0.5) * (torch.pi / height)
    towards = torch.stack(
        [theta.sin()[:, None] * phi.sin(), theta.cos()[:, None].expand(-1, len(phi)), -theta.sin()[:, None] * phi.cos()]
    )
    room = 0.5 + 0.3 * towards[1]
    radiance = torch.stack([room, room, 1.1 * room])
    for elevation, azimuth, radius in _LAMPS:
        a, b = torch.tensor([elevation, azimuth]).deg2rad()
        centre = torch.stack([a.sin() * b.sin(), a.cos(), -a.sin() * b.cos()])
        lit = torch.einsum("chw,c->hw", towards, centre) > torch.tensor(radius).deg2rad().cos()
        radiance += lit * (_LAMP / (1 - torch.tensor(radius).deg2rad().cos())) * _LAMP_COLOUR
    return tb.LightProbe(radiance, name="small lamps")
