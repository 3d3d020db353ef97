"""Training augmentations that hide pixels of photographed balls: an edge, a sensor, a stand, a camera, bad luck.

kornia augmentations of linear images (B, 3, H, W) and masks (B, 1, H, W). The image shows what hides the ball; masks in
the same `AugmentationSequential` lose those pixels where they are `known`. `occluders` holds one more.
"""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import torch
from kornia.augmentation import IntensityAugmentationBase2D
from torch import Tensor
from torch.nn.functional import interpolate

from torchbrdf.learning._drawing import DrawnInFloat32
from torchbrdf.learning.masking import (
    MARGIN,
    erode_silhouette,
    grown,
    mask_stand,
    reflection_angles,
    stand_radii,
)
from torchbrdf.view import SphereView, View

Range = tuple[float, float]


class DrawingAugmentation(DrawnInFloat32, IntensityAugmentationBase2D):
    """An augmentation of images that draws uniform numbers, in float32 whatever torch's default type is."""

    def uniform(self, batch_shape: Sequence[int], span: Range, *shape: int) -> Tensor:
        """(B, *shape) uniform in a range, equal for the whole batch with `same_on_batch`."""
        count = 1 if self.same_on_batch else batch_shape[0]
        drawn = span[0] + (span[1] - span[0]) * torch.rand(count, *shape, device=self.device, dtype=torch.float32)
        return drawn.expand(batch_shape[0], *shape)


class HidingAugmentation(DrawingAugmentation):
    """What the augmentations that hide pixels share: a subclass says which in `kept`, and may paint them in `shown`.

    known  whether masks tell; else a network or a robust estimator has to find out
    """

    def __init__(self, known: bool, same_on_batch: bool, p: float, keepdim: bool, **flags: Any) -> None:
        """Keep the settings where kornia prints them."""
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim)
        self.flags = {**flags, "known": known}

    def kept(self, shape: Sequence[int], params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor:
        """(B, 1, H, W) bool: what the drawn parameters leave visible of images of a shape (B, C, H, W)."""
        raise NotImplementedError

    def shown(self, image: Tensor, params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor | float:
        """What images (B, C, H, W) show where they are hidden."""
        return 0.0

    def apply_transform(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Hide pixels of images."""
        kept = self.kept(input.shape, params, flags).to(input.device)
        return torch.where(kept, input, self.shown(input, params, flags))

    def apply_transform_mask(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Take the same pixels out of masks, if they are known."""
        if not flags["known"]:
            return input
        return torch.where(self.kept(input.shape, params, flags).to(input.device), input, 0)


class RandomSilhouetteErosion(HidingAugmentation):
    """`erode_silhouette` of a view's mask by a random distance: a ball that was cut out too tightly.

    pixels  least and largest distance, whole numbers
    """

    eroded: Tensor

    def __init__(
        self,
        view: View,
        pixels: tuple[int, int] = (0, 3),
        known: bool = True,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
    ) -> None:
        """Erode the mask by every number of pixels once."""
        least, most = map(int, check_range(pixels, "pixels", 0))
        super().__init__(known, same_on_batch, p, keepdim, pixels=(least, most))
        steps = [erode_silhouette(view.mask, float(k)) for k in range(most + 1)]
        self.register_buffer("eroded", torch.stack(steps), persistent=False)

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw a distance for each image."""
        check_size(batch_shape, self.eroded)
        least, most = self.flags["pixels"]
        return {"pixels": self.uniform(batch_shape, (least, most + 1)).long().clamp_max(most)}

    def kept(self, shape: Sequence[int], params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor:
        """The eroded mask."""
        return self.eroded[params["pixels"].to(self.eroded.device)]


class RandomSaturation(HidingAugmentation):
    """Clip the brightest pixels of every image at a level of its own, as a sensor does.

    share   least and largest share of the lit pixels that is clipped
    margin  see `mask_saturated`; taken out of masks, not clipped
    The drawn parameters hold the pixels found in the image, so that masks of the same call, and of replays, lose them.
    """

    def __init__(
        self,
        share: Range = (0.0, 0.05),
        margin: float = MARGIN,
        known: bool = True,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
    ) -> None:
        """Check the range."""
        super().__init__(known, same_on_batch, p, keepdim, share=check_range(share, "share", 0, 1), margin=margin)

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw a share for each image; which pixels they are, the image tells."""
        return {"share": self.uniform(batch_shape, self.flags["share"])}

    def forward(self, input: Tensor, params: dict[str, Tensor] | None = None, **kwargs: Any) -> Tensor:
        """Clip images, and write down where in the parameters: a container hands the same to masks, but us a copy."""
        clipped = super().forward(input, params, **kwargs)
        if params is not None:
            params["unsaturated"] = self._params["unsaturated"]
        return clipped

    def apply_transform(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Clip, and write down where."""
        peak = input.amax(1).flatten(1)
        count = params["share"].to(peak) * (peak > 0).sum(1)
        most = min(peak.shape[1], int(flags["share"][1] * peak.shape[1]) + 2)
        level = peak.topk(most).values.gather(1, count.long().clamp_max(most - 1)[:, None])
        level = level[:, :, None, None].detach()
        params["unsaturated"] = grown((input <= level).all(1, keepdim=True), flags["margin"])
        return torch.where(input > level, level, input)  # the gradient of a pixel at the level is 1, not minimum's 1/2

    def kept(self, shape: Sequence[int], params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor:
        """The pixels found."""
        return params["unsaturated"]


class RandomStand(HidingAugmentation):
    """A stand below the ball and its reflection, see `mask_stand`, of random width and shade.

    radius    least and largest, in radii of the ball
    radiance  least and largest radiance of the stand, in mean radiances of the image
    """

    radii: Tensor

    def __init__(
        self,
        view: SphereView,
        radius: Range = (0.1, 0.35),
        radiance: Range = (0.05, 0.6),
        known: bool = True,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
    ) -> None:
        """Check the ranges and that the view is a ball."""
        flags = {"radius": check_range(radius, "radius", 0, 0.99), "radiance": check_range(radiance, "radiance", 0)}
        super().__init__(known, same_on_batch, p, keepdim, **flags)
        mask_stand(view, radius[0])
        self.register_buffer("radii", stand_radii(view), persistent=False)

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw width and shade for each image."""
        check_size(batch_shape, self.radii)
        shade = self.uniform(batch_shape, self.flags["radiance"], 1, 1, 1)
        return {"radius": self.uniform(batch_shape, self.flags["radius"]), "radiance": shade}

    def kept(self, shape: Sequence[int], params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor:
        """What the stand leaves visible; what is outside the ball stays as it is."""
        return grown(self.radii >= params["radius"][:, None, None, None].to(self.radii), MARGIN)

    def shown(self, image: Tensor, params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor | float:
        """A grey stand."""
        return params["radiance"].to(image) * image.mean((1, 2, 3), keepdim=True)


class RandomReflection(HidingAugmentation):
    """The camera, or whoever stands in `direction`, mirrored by the ball, see `mask_reflection`, of random size.

    half_angle_deg  least and largest; 5 degrees are a photographer's head and shoulders at 3 m
    darkening       least and largest share of the radiance that the reflection takes from the pixels
    """

    angles: Tensor

    def __init__(
        self,
        view: View,
        half_angle_deg: Range = (2.0, 10.0),
        darkening: Range = (0.1, 0.9),
        direction: Sequence[float] = (0.0, 0.0, 1.0),
        known: bool = True,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
    ) -> None:
        """Check the ranges and the direction."""
        flags = {
            "half_angle_deg": check_range(half_angle_deg, "half_angle_deg", 0, 180),
            "darkening": check_range(darkening, "darkening", 0, 1),
        }
        super().__init__(known, same_on_batch, p, keepdim, **flags)
        self.register_buffer("angles", reflection_angles(view, direction), persistent=False)

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw size and darkening for each image."""
        check_size(batch_shape, self.angles)
        size = self.uniform(batch_shape, self.flags["half_angle_deg"])
        return {"half_angle_deg": size, "darkening": self.uniform(batch_shape, self.flags["darkening"], 1, 1, 1)}

    def kept(self, shape: Sequence[int], params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor:
        """What shows no reflection; what is outside the shape stays as it is."""
        return grown(self.angles >= params["half_angle_deg"][:, None, None, None].to(self.angles), MARGIN)

    def shown(self, image: Tensor, params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor | float:
        """The ball, darkened."""
        return image * (1 - params["darkening"].to(image))


class RandomDropout(HidingAugmentation):
    """Drop pixels, or patches of them: dead pixels, dust, and a regulariser for networks.

    share  least and largest share of the patches
    patch  pixels along a side of a patch
    """

    def __init__(
        self,
        share: Range = (0.0, 0.2),
        patch: int = 1,
        known: bool = True,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
    ) -> None:
        """Check the range and the size of patches."""
        if patch < 1:
            raise ValueError(f"patch must be at least one pixel, got {patch}")
        super().__init__(known, same_on_batch, p, keepdim, share=check_range(share, "share", 0, 1), patch=patch)

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw a share for each image and a number for each patch."""
        size = [-(-extent // self.flags["patch"]) for extent in batch_shape[-2:]]
        luck = self.uniform(batch_shape, (0.0, 1.0), 1, *size)
        return {"share": self.uniform(batch_shape, self.flags["share"], 1, 1, 1), "luck": luck}

    def kept(self, shape: Sequence[int], params: Mapping[str, Tensor], flags: Mapping[str, Any]) -> Tensor:
        """The patches that were lucky."""
        kept = (params["luck"] >= params["share"]).float()
        return interpolate(kept, scale_factor=flags["patch"], mode="nearest")[..., : shape[-2], : shape[-1]] > 0.5


def check_size(shape: Sequence[int], seen: Tensor) -> None:
    """Raise ValueError for images of a shape (B, C, H, W) where a view is seen in others, (..., h, w)."""
    if tuple(shape[-2:]) != tuple(seen.shape[-2:]):
        given, wanted = (" x ".join(map(str, size[-2:])) for size in (shape, seen.shape))
        raise ValueError(f"images must be {wanted} as the view that their defects were made for is, got {given}")


def check_range(span: Range, what: str, low: float, high: float = float("inf")) -> Range:
    """The range itself. Raises ValueError where it is none, or not within [low, high]."""
    if len(span) != 2 or not low <= span[0] <= span[1] <= high or not all(map(isfinite, span)):
        raise ValueError(f"{what} must be a range (least, largest) within [{low:g}, {high:g}], got {span}")
    return float(span[0]), float(span[1])
