"""`Camera`: where the camera stands before a mesh, and what it shows of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians, sin, tan
from typing import Self

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.view.mesh import TriangleMesh

Triple = Sequence[float]
"""Three numbers."""


@dataclass(frozen=True)
class Camera:
    """Where the camera stands, in the axes of the mesh, which are those of the light probe.

    toward   from the target towards the camera, any length
    up       what is up in the image
    fov_deg  field of view across the width of the image in degrees; None for an orthographic camera
    target   what it looks at; None for the middle of the mesh's bounding box
    width    of what the image shows at the target; None for the mesh's bounding sphere to touch the borders
    """

    toward: Triple = (0.0, 0.0, 1.0)
    up: Triple = (0.0, 1.0, 0.0)
    fov_deg: float | None = None
    target: Triple | None = None
    width: float | None = None

    def __post_init__(self) -> None:
        """Check the values; vectors become tuples."""
        for name in ("toward", "up", "target"):
            vector = getattr(self, name)
            if vector is not None:
                if np.shape(vector) != (3,) or not np.isfinite(vector).all():
                    raise ValueError(f"the camera's {name} must be three finite numbers, got {vector}")
                object.__setattr__(self, name, tuple(float(number) for number in vector))
        check_fov(self.fov_deg)
        if self.width is not None and not 0 < self.width < float("inf"):
            raise ValueError(f"the width that a camera shows must be positive, got {self.width}")
        lengths = np.linalg.norm(self.toward) * np.linalg.norm(self.up)
        if not np.linalg.norm(np.cross(self.toward, self.up)) > 1e-6 * lengths:
            raise ValueError(f"the camera's up {self.up} must not be 0 or parallel to its direction {self.toward}")

    @classmethod
    def at(cls, position: Triple, target: Triple, fov_deg: float, up: Triple = (0.0, 1.0, 0.0)) -> Self:
        """A perspective camera at a position that looks at a target."""
        toward = np.subtract(position, target)
        if not np.any(toward):
            raise ValueError(f"the camera's position must differ from its target, got {position} for both")
        width = 2 * float(np.linalg.norm(toward)) * tan(radians(fov_deg) / 2)
        return cls(toward.tolist(), up, fov_deg, target, width)


@dataclass(frozen=True)
class Framing:
    """A camera before one shape; all (3,) float64 in the shape's units.

    right, top, back  unit vectors: image right, image top, towards the camera
    target            the middle of the image
    half_width        of what the image shows at the target
    distance          from the target to the camera, or to where the rays of an orthographic one start
    fov_deg           field of view across the width of the image; None for an orthographic camera
    """

    right: Tensor
    top: Tensor
    back: Tensor
    target: Tensor
    half_width: float
    distance: float
    fov_deg: float | None

    @classmethod
    def of_sphere(cls, fov_deg: float | None, rotation: Tensor) -> "Framing":
        """Of a unit sphere at the origin that touches the borders of the image, seen along -Z turned by a rotation."""
        right, top, back = rotation.T
        half_width, distance = 1.0, 4.0
        if fov_deg is not None:
            half = radians(fov_deg) / 2
            distance = 1 / sin(half)  # the cone of view touches the sphere
            half_width = distance * tan(half)
        return cls(right, top, back, torch.zeros(3, dtype=torch.float64), half_width, distance, fov_deg)

    @classmethod
    def of_mesh(cls, camera: Camera, mesh: TriangleMesh) -> "Framing":
        """Fill in what the camera leaves to the mesh."""
        back = normalize(torch.tensor(camera.toward, dtype=torch.float64), dim=0)
        right = normalize(torch.linalg.cross(torch.tensor(camera.up, dtype=torch.float64), back), dim=0)
        target = torch.tensor(mesh.centre if camera.target is None else camera.target, dtype=torch.float64)
        beyond = float(np.linalg.norm(mesh.centre - target.numpy())) + mesh.radius
        if camera.fov_deg is None:
            half_width = mesh.radius if camera.width is None else camera.width / 2
            distance = 2 * beyond
        else:
            half = radians(camera.fov_deg) / 2
            half_width = mesh.radius / sin(half) * tan(half) if camera.width is None else camera.width / 2
            distance = half_width / tan(half)
        top = torch.linalg.cross(back, right)
        return cls(right, top, back, target, half_width, distance, camera.fov_deg)


def check_fov(fov_deg: float | None) -> None:
    """Raise ValueError where a field of view is none; None is an orthographic camera."""
    if fov_deg is not None and not 0 < fov_deg < 180:
        raise ValueError(f"fov_deg must lie between 0 and 180 degrees, got {fov_deg}; None is orthographic")
