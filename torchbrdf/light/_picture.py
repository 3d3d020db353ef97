"""From a file with a picture of light to lat-long radiance, and to words that say how the file was read."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import torch
from torch import Tensor

from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.images import ColourSpace, Picture, read_environment_map, read_metadata, read_picture
from torchbrdf.light._soundness import fill, share_and_place, sound, warn
from torchbrdf.light.lamps import Lamps, bounded, lamps_of
from torchbrdf.light.latlong import LEAST_HEIGHT, from_bands, from_edge_columns, resize, row_solid_angles
from torchbrdf.light.layouts import Circle, Cube, Disc, layout_of, looks_like
from torchbrdf.light.mirror import MirrorPicture, Reflection
from torchbrdf.light.settings import Layout, Rows

ROWS_KEY = "probeRows"
"""The attribute of our own .exr files that holds their `Rows`."""

LAMPS_KEY = "probeLamps"
"""That which says, by `KNOWN`, that texels at the maximum are as bright as the file has them."""

KNOWN = "known"

_EDGE = 1.0  # pixels at the edge of a disc that a mask may lack: masks are drawn roughly


@dataclass(frozen=True)
class LightPicture:
    """A file, and how it is to be read, as in `LightProbe.open`."""

    path: Path
    layout: Layout = "latlong"
    rows: Rows | None = None
    circle: Circle | None = None
    mask: Tensor | None = None
    reflectance: float | Sequence[float] | None = None
    fov_deg: float | None = None
    primaries: ColourSpace = "rec709"
    layer: str | None = None
    unknown_lamps: bool = False

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"light probe {self.path}"

    def to_latlong(self, height: int | None, repair: bool) -> tuple[Tensor, Lamps | None, str]:
        """Sound radiance (3, H, 2 H), what of it may be clipped, and how the file was read, in words."""
        self._check()
        picture = read_picture(
            self.path, None, layer=self.layer, primaries=self.primaries, layer_option="--probe-layer"
        )
        marked, kind, known = _said_by(self.path)
        layout: Layout = "envmap_cube" if self.layout == "latlong" and kind == "cube" else self.layout
        image, cropped = self._recorded(picture, layout)
        layers, lamps, said = self._placed(image, layout, marked, kind, height, repair)
        lamps = None if lamps is None or known else lamps.of(layers[3:])
        return layers[:3], lamps, ", ".join([*picture.about, *cropped, said])

    def _sound(self, image: Tensor, weights: Tensor, repair: bool) -> tuple[Tensor, Lamps | None]:
        """(3, h, w) sound radiance, or (6, h, w), followed by that of the lamps; and the lamps."""
        image, infinite = bounded(image, weights, self.name) if self.unknown_lamps else (image, None)
        image = sound(image, weights, repair, self.name, self.unknown_lamps)
        lamps = lamps_of(image, weights, infinite)
        return (image, None) if lamps is None else (torch.cat([image, lamps.radiance]), lamps)

    def _recorded(self, picture: Picture, layout: Layout) -> tuple[Tensor, list[str]]:
        """The image, or the part of it that was recorded where that is the picture, and what to say of it."""
        if picture.window is None or self.circle is not None:
            return picture.image, []
        window = picture.window
        wide = {"latlong": 2.0, "angular": 1.0, "mirror_ball": 1.0}.get(layout, math.nan)
        if picture.image.shape[2] != wide * picture.image.shape[1] and window.width == wide * window.height:
            return picture.image[:, *window.slices], [f"the {window.height} x {window.width} pixels recorded"]
        raise ValueError(
            f"{self.name} recorded only {window.height} x {window.width} of its {picture.image.shape[1]} x "
            f"{picture.image.shape[2]} pixels; write it whole"
        )

    def _placed(
        self, image: Tensor, layout: Layout, marked: str | None, kind: str | None, height: int | None, repair: bool
    ) -> tuple[Tensor, Lamps | None, str]:
        """Layers of `_sound` in lat-long, from an image of this layout; marked, kind  as of `_said_by`."""
        if layout != "latlong":
            return self._converted(layout, image, height, repair)
        check_proportions(image.shape[1], image.shape[2], self.name)
        if self.rows == "centres" or (self.rows is None and marked != "poles" and kind is None):
            return *self._of_bands(image, height, repair), "rows at pixel centres"
        layers, lamps = self._sound(image, row_solid_angles(image.shape[1], 1)[:, None], repair)
        said = "rows from pole to pole"
        if self.rows is None and marked == "poles":
            said += ", as the file says"
        elif self.rows is None:
            layers = from_edge_columns(layers)
            said += " and columns from edge to edge, as its envmap attribute says"
        return layers if height in (None, len(layers[0])) else resize(layers, height), lamps, said

    def _check(self) -> None:
        layouts, all_rows = get_args(Layout), get_args(Rows)
        if self.layout not in layouts:
            raise ValueError(f"layout must be one of {', '.join(layouts)}, got {self.layout!r}")
        if self.rows not in (None, *all_rows):
            raise ValueError(f"rows must be one of {', '.join(all_rows)}, got {self.rows!r}")
        disc = self.layout in ("angular", "mirror_ball")
        for option, given, fits, where in (
            ("--probe-rows (rows= in Python)", self.rows, self.layout == "latlong", "latlong"),
            ("--probe-mask (mask= in Python)", self.mask, disc, "mirror_ball and angular"),
            ("--probe-circle (circle= in Python)", self.circle, disc, "mirror_ball and angular"),
            ("--mirror-reflectance (reflectance= in Python)", self.reflectance, self.layout == "mirror_ball",
             "mirror_ball"),
            ("--probe-fov (fov_deg= in Python)", self.fov_deg, self.layout == "mirror_ball", "mirror_ball"),
        ):  # fmt: skip
            if given is not None and not fits:
                raise ValueError(
                    f"{self.name}: {option} goes with --probe-layout {where} (layout= in Python), got {self.layout}"
                )

    def _of_bands(self, image: Tensor, height: int | None, repair: bool) -> tuple[Tensor, Lamps | None]:
        h = image.shape[1]
        areas = torch.cos(torch.arange(h + 1, dtype=torch.float64) * (math.pi / h)).diff().neg()[:, None]
        layers, lamps = self._sound(image, areas, repair)
        return from_bands(layers, height or h * math.ceil(LEAST_HEIGHT / h)), lamps

    def _converted(
        self, layout: Layout, image: Tensor, height: int | None, repair: bool
    ) -> tuple[Tensor, Lamps | None, str]:
        title = layout.replace("_", " ")
        what = f"{self.name}, a picture of layout {layout},"
        picture: Disc | Cube | MirrorPicture = layout_of(layout).placed(
            (image.shape[1], image.shape[2]), self.circle, what
        )
        if isinstance(picture, Disc) and self.fov_deg is not None:
            camera = PinholeCamera.of_fov(picture.size, self.fov_deg)
            picture = MirrorPicture(Reflection(Ball.of_circle(camera, *picture.circle)))
        weights = picture.weights()
        said = f"{title}, {picture.description}"
        excluded = torch.zeros_like(weights, dtype=torch.bool)
        if self.mask is not None:
            excluded = self._excluded(self.mask, weights, picture.weights(_EDGE) > 0, repair)
        layers, lamps = self._sound(image, torch.where(excluded, 0.0, weights), repair)
        layers = fill(layers, (weights > 0) & ~excluded, excluded)
        if self.reflectance is not None:
            factors = checked_reflectance(self.reflectance)
            layers = layers.unflatten(0, (-1, 3)) / layers.new_tensor(factors).view(-1, 1, 1)
            layers = layers.flatten(0, 1)
            said += f", reflectance {' '.join(f'{factor:g}' for factor in factors)}"
        return picture.to_latlong(layers, height or max(picture.rows, LEAST_HEIGHT)), lamps, said

    def _excluded(self, mask: Tensor, weights: Tensor, inner: Tensor, repair: bool) -> Tensor:
        """(H, W) bool: pixels of the disc that the mask lacks. In its inner part they are an error without `repair`."""
        if mask.shape != (1, *weights.shape) or mask.dtype != torch.bool:
            raise ValueError(
                f"{self.name}: the mask must be as large as the picture, (1, {weights.shape[0]}, {weights.shape[1]}) "
                f"bool, got {tuple(mask.shape)} {mask.dtype}"
            )
        excluded = (weights > 0) & ~mask[0].cpu()
        unknown = excluded & inner
        if not bool(((weights > 0) & ~excluded).any()):
            raise ValueError(f"{self.name}: the mask leaves no pixel of the disc; it must be white where the disc is")
        if bool(unknown.any()):
            what = f"{self.name}: the mask leaves out {share_and_place(unknown, weights)}"
            if not repair:
                raise ValueError(
                    f"{what}; give --repair-probe (repair=True in Python) to fill that from around it, or a mask "
                    "without holes"
                )
            warn(f"{what}; filled from around it")
        return excluded


def check_proportions(height: int, width: int, name: str) -> None:
    """Raise ValueError for a picture that is not lat-long."""
    if width != 2 * height or height < 2:
        raise ValueError(
            f"{name} must be lat-long (width = 2 x height), got {height} x {width}; {looks_like(height, width)}"
        )


def checked_reflectance(given: float | Sequence[float]) -> list[float]:
    """One or three shares of the light. Raises ValueError for others."""
    factors = [float(each) for each in ([given] if isinstance(given, (int, float)) else given)]
    if len(factors) not in (1, 3) or not all(0 < each <= 1 for each in factors):
        raise ValueError(
            "--mirror-reflectance (reflectance= in Python) must be one or three numbers above 0 and at most 1, got "
            + " ".join(f"{each:g}" for each in factors)
        )
    return factors


def _said_by(path: Path) -> tuple[str | None, str | None, bool]:
    """What an .exr file says: our own mark of its rows; "latlong" or "cube" where it is an environment map; KNOWN."""
    if path.suffix.lower() != ".exr":
        return None, None, False
    said = read_metadata(path)
    return said.get(ROWS_KEY), read_environment_map(path), said.get(LAMPS_KEY) == KNOWN
