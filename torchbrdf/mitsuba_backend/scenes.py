"""`MitsubaScene`: a view under a probe as a Mitsuba scene, rendered with one BSDF at a time.

Mitsuba's `envmap` and `LightProbe` share one convention, so a probe goes over unchanged.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.arguments import whole
from torchbrdf.brdf import MerlTable
from torchbrdf.light import LightProbe, checked_rotation
from torchbrdf.mitsuba_backend.merl_plugin import merl_bsdf, table_values
from torchbrdf.mitsuba_startup import MitsubaUnavailableError as MitsubaUnavailableError, is_vectorised, load_mitsuba
from torchbrdf.view import Camera as Camera, Framing, MeshView, View, to_mitsuba_mesh

SceneDict = dict[str, Any]
"""A scene, or a part of one, as `mitsuba.load_dict` takes it."""

_PATHS_AT_ONCE = 1 << 22


@dataclass(frozen=True)
class HalfRenderings:
    """A rendering as two halves of its samples, which are independent.

    first, second  (3, H, W)  radiance, 0 outside the mask
    """

    first: Tensor
    second: Tensor

    @property
    def image(self) -> Tensor:
        """(3, H, W): the mean of the halves."""
        return (self.first + self.second) / 2

    @property
    def noise(self) -> float:
        """Relative RMS of the image's Monte Carlo error: the halves differ by twice as much."""
        image = torch.linalg.vector_norm(self.image.double())
        return float(torch.linalg.vector_norm((self.first - self.second).double()) / (2 * image))


class MitsubaScene:
    """A view under a probe.

    bsdf        what the shape is made of: a table, or any Mitsuba BSDF as a dictionary
    integrator  Mitsuba's, as a dictionary; default: `direct`, light that is reflected once. `{"type": "path"}`
                adds what the shape reflects onto itself
    rotation    (3, 3) of the probe, as `LightProbe.rotated` takes it, but nothing is resampled; None for none
    scene       the `mitsuba.Scene`
    Raises ValueError for a view without a shape (NormalMapView).
    """

    def __init__(
        self,
        view: View,
        probe: LightProbe,
        bsdf: MerlTable | Mapping[str, Any],
        integrator: Mapping[str, Any] | None = None,
        rotation: Tensor | None = None,
    ) -> None:
        """Build the scene."""
        self._mi = load_mitsuba()
        self.view = view
        description = merl_bsdf(bsdf) if isinstance(bsdf, MerlTable) else dict(bsdf)
        self.scene = self._mi.load_dict(
            {
                "type": "scene",
                "integrator": dict(integrator or {"type": "direct"}),
                "sensor": sensor(self._mi, view),
                "light": light(self._mi, probe, rotation),
                "shape": shape(self._mi, view, description),
            }
        )

    def set_table(self, table: MerlTable) -> None:
        """Give the shape another table; nothing is compiled anew."""
        parameters = self._mi.traverse(self.scene)
        keys = [key for key in dict(parameters) if key.endswith(".values")]
        if len(keys) != 1:
            raise ValueError("set_table needs a scene whose BSDF is the plugin merl; make it with a MerlTable")
        parameters[keys[0]] = self._mi.TensorXf(table_values(table))
        parameters.update()

    def render(self, samples: int, seed: int = 0) -> Tensor:
        """Radiance (3, H, W), 0 outside the mask, with some samples a pixel."""
        samples = whole("samples", samples)
        if samples < 1:
            raise ValueError(f"a rendering needs at least 1 sample a pixel, got {samples}")
        height, width = self.view.size
        most = max(1, _PATHS_AT_ONCE // (height * width)) if is_vectorised(self._mi) else samples
        counts = [min(most, samples - done) for done in range(0, samples, most)]
        total = np.zeros((height, width, 3))
        for index, count in enumerate(counts):
            one_seed = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
            total += count * np.asarray(self._mi.render(self.scene, spp=count, seed=one_seed), dtype=float)
        image = torch.from_numpy(total / samples).permute(2, 0, 1).float()
        return torch.where(self.view.mask, image, 0)

    def render_halves(self, samples: int, seed: int = 0) -> HalfRenderings:
        """The same in two halves, which tell the noise; at least 2 samples a pixel."""
        if samples < 2:
            raise ValueError(f"two halves need at least 2 samples a pixel, got {samples}")
        return HalfRenderings(*(self.render(samples // 2, 2 * seed + half) for half in range(2)))


def light(mi: ModuleType, probe: LightProbe, rotation: Tensor | None = None) -> SceneDict:
    """The probe as an `envmap`, turned by a rotation (3, 3)."""
    pixels = probe.radiance.detach().cpu().permute(1, 2, 0).contiguous().numpy()
    to_world = np.eye(4)
    if rotation is not None:
        to_world[:3, :3] = checked_rotation(rotation).numpy()
    bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.RGB)
    return {"type": "envmap", "bitmap": bitmap, "to_world": mi.ScalarTransform4f(to_world)}


def sensor(mi: ModuleType, view: View) -> SceneDict:
    """The camera of a view: linear RGB, means over the areas of pixels."""
    framing = framing_of(view)
    height, width = view.size
    origin = framing.target + framing.distance * framing.back
    points = {"origin": origin.tolist(), "target": framing.target.tolist(), "up": framing.top.tolist()}
    to_world = mi.ScalarTransform4f().look_at(**points)
    film = {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "rgb",
        "component_format": "float32",
        "filter": {"type": "box"},
    }
    common = {"film": film, "sampler": {"type": "independent"}, "near_clip": 1e-3 * framing.distance}
    common["far_clip"] = 1e3 * framing.distance
    if framing.fov_deg is None:
        scale = mi.ScalarTransform4f().scale([framing.half_width, framing.half_width, 1])
        return {"type": "orthographic", "to_world": to_world @ scale, **common}
    return {"type": "perspective", "to_world": to_world, "fov": framing.fov_deg, "fov_axis": "x", **common}


def shape(mi: ModuleType, view: View, bsdf: Mapping[str, Any]) -> Any:
    """The shape of a view with a BSDF."""
    if isinstance(view, MeshView):
        return to_mitsuba_mesh(mi, view.mesh, mi.load_dict(dict(bsdf)))
    return {"type": "sphere", "bsdf": dict(bsdf)}


def framing_of(view: View) -> Framing:
    """The camera of a view. Raises ValueError where it has no shape to trace."""
    if view.framing is None:
        raise ValueError(f"Mitsuba needs a shape to trace, got {view}; give a SphereView or a MeshView")
    return view.framing
