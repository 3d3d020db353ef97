"""Where a ball stands before a camera at the origin that looks along -Z, and the ellipse that it is in the picture."""

from dataclasses import asdict, dataclass
from math import asin, atan2, cos, degrees, radians, sin, sqrt, tan

import numpy as np


@dataclass(frozen=True)
class Frame:
    """A pinhole camera's picture: pixels, and the horizontal field of view in degrees. The axis is in its middle."""

    height: int = 480
    width: int = 720
    fov_deg: float = 24.0

    @property
    def focal(self) -> float:
        """In pixels."""
        return self.width / 2 / tan(radians(self.fov_deg) / 2)

    def widened(self, margin: int) -> "Frame":
        """With a margin of so many pixels on all sides, by the same camera."""
        width = self.width + 2 * margin
        fov_deg = 2 * degrees(atan2(width / 2, self.focal))
        return Frame(self.height + 2 * margin, width, fov_deg)


@dataclass(frozen=True)
class Ellipse:
    """Middle, half axes (the first is the longer) and the first one's angle to image right, y down: pixels, degrees."""

    x: float
    y: float
    a: float
    b: float
    angle_deg: float


@dataclass(frozen=True)
class Placement:
    """A ball of radius 1: the unit direction to its middle, and how far that is."""

    direction: tuple[float, float, float]
    distance: float

    @property
    def centre(self) -> np.ndarray:
        """(3,) in radii."""
        return self.distance * np.array(self.direction)

    @property
    def radius_deg(self) -> float:
        """The angular radius."""
        return degrees(asin(1 / self.distance))

    @property
    def off_axis_deg(self) -> float:
        """The angle between the camera's axis and the ball's middle."""
        return degrees(atan2(float(np.hypot(*self.direction[:2])), -self.direction[2]))

    def ellipse(self, frame: Frame) -> Ellipse:
        """The silhouette: where the cone of tangents meets the plane of the picture."""
        psi, alpha = radians(self.off_axis_deg), radians(self.radius_deg)
        near, far = tan(psi - alpha), tan(psi + alpha)
        across = sin(alpha) / sqrt(cos(alpha) ** 2 - sin(psi) ** 2)
        turn = atan2(-self.direction[1], self.direction[0])
        middle = frame.focal * (near + far) / 2
        x, y = frame.width / 2 + middle * cos(turn), frame.height / 2 + middle * sin(turn)
        return Ellipse(x, y, frame.focal * (far - near) / 2, frame.focal * across, degrees(turn))

    def window(self, frame: Frame, margin: int = 3) -> tuple[slice, slice]:
        """Rows and columns of the picture that hold the ball, and a margin of so many pixels."""
        ellipse = self.ellipse(frame)
        cosine, sine = cos(radians(ellipse.angle_deg)), sin(radians(ellipse.angle_deg))
        half_width = np.hypot(ellipse.a * cosine, ellipse.b * sine) + margin
        half_height = np.hypot(ellipse.a * sine, ellipse.b * cosine) + margin
        rows = max(0, int(ellipse.y - half_height)), min(frame.height, int(np.ceil(ellipse.y + half_height)))
        columns = max(0, int(ellipse.x - half_width)), min(frame.width, int(np.ceil(ellipse.x + half_width)))
        return slice(*rows), slice(*columns)

    def described(self, frame: Frame) -> dict[str, object]:
        """For truth.json; `circle` has the middle and the area of the ellipse."""
        ellipse = self.ellipse(frame)
        return {
            "direction": list(self.direction),
            "distance": self.distance,
            "radius_deg": self.radius_deg,
            "off_axis_deg": self.off_axis_deg,
            "ellipse": asdict(ellipse),
            "circle": [ellipse.x, ellipse.y, sqrt(ellipse.a * ellipse.b)],
        }


def towards(x_deg: float, y_deg: float) -> tuple[float, float, float]:
    """The unit direction that appears so many degrees to the right of the axis and above it."""
    vector = np.array([tan(radians(x_deg)), tan(radians(y_deg)), -1.0])
    x, y, z = (vector / np.linalg.norm(vector)).tolist()
    return x, y, z
