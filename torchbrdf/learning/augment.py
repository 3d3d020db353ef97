"""Training augmentations of linear photographs and light probes, on kornia's operators and base classes.

What a camera does to radiance is here: exposure, flicker, noise. kornia's own brightness and colour classes assume
[0, 1]; brightness adds, and noise has one size for dark and bright. The rest is collected from its modules, so that
`torchbrdf.learning` names all of them; they compose in `kornia.augmentation.AugmentationSequential`.
"""

from math import pi
from typing import Any

import torch
from kornia.augmentation import AugmentationSequential
from kornia.filters import gaussian_blur2d
from torch import Tensor

from torchbrdf.arguments import check_types
from torchbrdf.learning.hiding import (
    DrawingAugmentation,
    RandomDropout,
    RandomReflection,
    RandomSaturation,
    RandomSilhouetteErosion,
    RandomStand,
    Range,
    check_range,
)
from torchbrdf.learning.masking import erode_silhouette, mask_reflection, mask_saturated, mask_stand
from torchbrdf.learning.occluders import RandomOccluders, draw_occluders, pixel_grid
from torchbrdf.learning.probe_rotation import RandomProbeRotation, random_rotations, rotate_probes
from torchbrdf.view import SphereView, View

__all__ = [
    "RandomDropout",
    "RandomExposure",
    "RandomFlicker",
    "RandomOccluders",
    "RandomProbeRotation",
    "RandomReflection",
    "RandomSaturation",
    "RandomSensorNoise",
    "RandomSilhouetteErosion",
    "RandomStand",
    "draw_occluders",
    "erode_silhouette",
    "flicker",
    "mask_reflection",
    "mask_saturated",
    "mask_stand",
    "photograph_defects",
    "pixel_grid",
    "random_rotations",
    "rotate_probes",
    "sensor_noise",
]


def flicker(rows: int, amplitude: Tensor, periods: Tensor, phase: Tensor) -> Tensor:
    """Gain of every row of an image taken with a rolling shutter under light that flickers.

    1 + amplitude sin(2 pi periods (row + 1/2) / rows + phase)
    amplitude, periods, phase  (*batch,)
    returns                    (*batch, 1, rows, 1)
    """
    place = ((torch.arange(rows, dtype=amplitude.dtype, device=amplitude.device) + 0.5) / rows)[:, None]
    amplitude, periods, phase = (one[..., None, None, None] for one in (amplitude, periods, phase))
    return 1 + amplitude * torch.sin(2 * pi * periods * place + phase)


def sensor_noise(image: Tensor, white: Tensor, shot: Tensor | float, read: Tensor | float, blur: float = 0.0) -> Tensor:
    """The noise of a sensor, to be added to linear images.

    Its variance is (shot^2 L / m + read^2) m^2 with m the mean radiance of the image (outside the ball, too).
    image       (B, C, H, W)  linear radiance L
    white       (B, C, H, W)  standard normal
    shot, read  (B, 1, 1, 1)  relative standard deviations at the mean radiance, of photons and of the electronics
    blur        standard deviation in pixels of a Gaussian that correlates neighbours (demosaicking, denoising in the
                camera), which keeps the variance. Raises ValueError where it reaches farther than the image, which it
                goes around
    """
    if blur > 0:
        reach = 2 * int(3 * blur + 0.5) + 1
        if reach // 2 > min(white.shape[-2:]):
            size = " x ".join(map(str, white.shape[-2:]))
            raise ValueError(f"blur {blur:g} reaches {reach // 2} pixels far, farther than images of {size}; give less")
        options: dict[str, Any] = {"kernel_size": (reach, reach), "sigma": (blur, blur)}
        impulse = torch.zeros(1, 1, reach, reach, dtype=white.dtype, device=white.device)
        impulse[..., reach // 2, reach // 2] = 1
        spread = gaussian_blur2d(impulse, **options, border_type="constant").norm()
        white = gaussian_blur2d(white, **options, border_type="circular") / spread
    mean = image.mean((1, 2, 3), keepdim=True)
    variance = shot**2 * image.clamp_min(0) * mean + (read * mean) ** 2
    return variance.sqrt() * white


class RandomExposure(DrawingAugmentation):
    """Brightness and colour by factors: exposure and white balance of linear images.

    stops   least and largest exposure; 1 is twice as bright
    colour  each channel differs from that by at most so many stops
    """

    def __init__(
        self,
        stops: Range = (-0.5, 0.5),
        colour: float = 0.0,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
    ) -> None:
        """Check the ranges."""
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim)
        check_range((0, colour), "colour", 0)
        self.flags = {"stops": check_range(stops, "stops", -float("inf")), "colour": colour}

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw a gain for each image and channel."""
        colour = self.flags["colour"]
        stops = self.uniform(batch_shape, self.flags["stops"], 1, 1, 1)
        return {"gain": torch.exp2(stops + self.uniform(batch_shape, (-colour, colour), batch_shape[1], 1, 1))}

    def apply_transform(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Multiply images."""
        return input * params["gain"].to(input)


class RandomFlicker(DrawingAugmentation):
    """Bands of a rolling shutter under light that flickers, see `flicker`.

    amplitude  least and largest
    periods    least and largest number from the top to the bottom of the image
    """

    def __init__(
        self,
        amplitude: Range = (0.0, 0.2),
        periods: Range = (0.5, 4.0),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
    ) -> None:
        """Check the ranges."""
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim)
        amplitude, periods = check_range(amplitude, "amplitude", 0, 1), check_range(periods, "periods", 0)
        self.flags = {"amplitude": amplitude, "periods": periods}

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw bands for each image."""
        spans = {**self.flags, "phase": (0.0, 2 * pi)}
        return {name: self.uniform(batch_shape, span) for name, span in spans.items()}

    def apply_transform(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Multiply the rows of images."""
        return input * flicker(input.shape[-2], *(params[k].to(input) for k in ("amplitude", "periods", "phase")))


class RandomSensorNoise(DrawingAugmentation):
    """Noise of photons and electronics, see `sensor_noise`, of random size.

    shot, read  least and largest
    blur        in pixels
    """

    def __init__(
        self,
        shot: Range = (0.0, 0.02),
        read: Range = (0.0, 0.005),
        blur: float = 0.0,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
    ) -> None:
        """Check the ranges."""
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim)
        check_range((0, blur), "blur", 0)
        self.flags = {"shot": check_range(shot, "shot", 0), "read": check_range(read, "read", 0), "blur": blur}

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw sizes, and noise for each pixel."""
        count = 1 if self.same_on_batch else batch_shape[0]
        white = torch.randn(count, *batch_shape[1:], device=self.device, dtype=torch.float32).expand(batch_shape)
        sizes = {name: self.uniform(batch_shape, self.flags[name], 1, 1, 1) for name in ("shot", "read")}
        return {**sizes, "white": white}

    def apply_transform(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Add noise to images."""
        white, shot, read = (params[name].to(input) for name in ("white", "shot", "read"))
        return input + sensor_noise(input, white, shot, read, flags["blur"])


def photograph_defects(view: SphereView, known: bool = False) -> AugmentationSequential:
    """What goes wrong in a photograph of a ball, in the order in which light meets it.

    An `AugmentationSequential` of images (B, 3, H, W) and masks (B, 1, H, W): reflection of the camera, stand, objects
    in front, flicker, exposure, noise, clipping, dead pixels. A starting point: copy it and change what differs.
    known  whether masks lose what objects, stand and reflection hide; clipped and dead pixels are always known
    Raises ValueError where view is none.
    """
    check_types("photograph_defects", view=(view, View))
    return AugmentationSequential(
        RandomReflection(view, known=known),
        RandomStand(view, known=known),
        RandomOccluders(known=known),
        RandomFlicker(),
        RandomExposure((-0.1, 0.1)),
        RandomSensorNoise(),
        RandomSaturation(),
        RandomDropout((0.0, 0.02)),
        data_keys=["input", "mask"],
    )
