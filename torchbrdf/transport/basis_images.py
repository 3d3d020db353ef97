"""Basis images Y: what every basis BRDF looks like under one light from one view [CBP21, eqs. 4-5]."""

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from torchbrdf.brdf import MaterialLibrary, check_different, columns_of, position_among
from torchbrdf.files import existing_file, writing
from torchbrdf.lasting import without_autocast
from torchbrdf.light import LightProbe
from torchbrdf.view import View, pack, unpack

FEWEST_NORMALS = 0.15
"""Share of a sphere's normals that a shape must show for its photograph to tell the BRDF (docs/known_shapes.md)."""

_AGAIN = "render the basis again (`torchbrdf bake`)"
_FORMAT = "torchbrdf basis images 1"
_ORIGIN = ("library", "probe", "view", "description")
_TYPES = {"packed": torch.float32, "mask": torch.bool, "relative_errors": torch.float32}


@dataclass(frozen=True, eq=False, repr=False)
class BasisImages:
    """Y, packed over the pixels of the mask.

    packed           (n, 3, P)  float32 radiance; row 3 i + c is channel c of material i
    mask             (1, H, W)  bool, the view's mask; P of its pixels are True
    names            the materials, n = 3 len(names)
    library          fingerprint of the columns behind the names
    probe, view      fingerprints of the light and of the shape
    description      how it was rendered
    normal_coverage  of the view: share of a sphere's normals that the shape shows
    relative_errors  (n,)  estimated relative RMS error of each image; None where the renderer gives none
    """

    packed: Tensor
    mask: Tensor
    names: tuple[str, ...]
    library: str
    probe: str
    view: str
    description: str = ""
    normal_coverage: float = 1.0
    relative_errors: Tensor | None = None

    def __post_init__(self) -> None:
        """Check that the shapes belong together."""
        expected = (3 * len(self.names), 3, int(self.mask.sum()))
        if tuple(self.packed.shape) != expected:
            raise ValueError(f"packed must be {expected} for these names and this mask, got {tuple(self.packed.shape)}")
        if self.relative_errors is not None and self.relative_errors.shape != expected[:1]:
            raise ValueError(f"relative_errors must be {expected[:1]}, got {tuple(self.relative_errors.shape)}")

    @classmethod
    def of(
        cls,
        packed: Tensor,
        library: MaterialLibrary,
        probe: LightProbe,
        view: View,
        description: str,
        relative_errors: Tensor | None = None,
    ) -> "BasisImages":
        """Images (n, 3, P) with what they were rendered from; relative_errors (n,) where the renderer tells them."""
        return cls(
            packed=packed,
            mask=view.mask,
            names=library.names,
            library=library.source,
            probe=probe.fingerprint,
            view=view.fingerprint,
            description=description,
            normal_coverage=view.normal_coverage,
            relative_errors=relative_errors,
        )

    def __repr__(self) -> str:
        """Size and origin."""
        n, _, p = self.packed.shape
        height, width = self.size
        return f"BasisImages(n = {n}, {height} x {width}, {p} pixels; {self.description})"

    @property
    def n(self) -> int:
        """The number of basis images."""
        return self.packed.shape[0]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of an image."""
        return self.mask.shape[-2], self.mask.shape[-1]

    @property
    def distrust(self) -> str | None:
        """Why no reconstruction from this view is to be trusted; None where its normals suffice."""
        if self.normal_coverage >= FEWEST_NORMALS:
            return None
        return (
            f"the shape shows only {self.normal_coverage:.1%} of the normals of a sphere: a plane, a cube and the like "
            "tell too little about a BRDF, do not trust the result; photograph a shape that is curved both ways"
        )

    def to(self, device: torch.device | str) -> "BasisImages":
        """The same images on another device."""
        errors = None if self.relative_errors is None else self.relative_errors.to(device)
        return replace(self, packed=self.packed.to(device), mask=self.mask.to(device), relative_errors=errors)

    def subset(self, names: Sequence[str]) -> "BasisImages":
        """The images of some materials only, in the order given. Raises ValueError for none, or one named twice."""
        if not names:
            raise ValueError("basis images need at least one material, got none")
        check_different(names)
        rows = columns_of([self._position(name) for name in names]).to(self.packed.device)
        errors = None if self.relative_errors is None else self.relative_errors[rows]
        return replace(self, packed=self.packed[rows], names=tuple(names), relative_errors=errors)

    def without(self, *names: str) -> "BasisImages":
        """The images less some materials (leave-one-out)."""
        dropped = {self._position(name) for name in names}
        return self.subset([name for i, name in enumerate(self.names) if i not in dropped])

    def _position(self, name: str) -> int:
        return position_among(self.names, name, f"among these {len(self.names)} basis images")

    def image(self, material: str) -> Tensor:
        """(3, H, W): the material itself under the light, each channel of it in its own colour of the light."""
        return self.unpack(own_images(self.subset([material]).packed)[0])

    @without_autocast
    def render(self, weights: Tensor) -> Tensor:
        """What combinations B w of the basis BRDFs look like, Y w [CBP21, eq. 4]: differentiable.

        weights  (*batch, n, 3)  of the colour channels, such as `Reconstruction.weights`
        returns  (*batch, 3, H, W)  in the precision of the weights, 0 outside the mask, with gradients to the weights
                 and to `packed`. Where B w is below zero it counts as such; `MaterialLibrary.combine` clamps it
        Raises ValueError for other weights.
        """
        if not isinstance(weights, Tensor):
            raise ValueError(f"weights must be a tensor, got {type(weights).__name__}; such as result.weights")
        if weights.shape[-2:] != (self.n, 3) or not weights.is_floating_point():
            raise ValueError(
                f"weights must be (*batch, {self.n}, 3) floating-point numbers for these basis images, "
                f"got {tuple(weights.shape)} {weights.dtype}"
            )
        return self.unpack(torch.einsum("...ns,nsp->...sp", weights, self.packed.to(weights.dtype)))

    def pack(self, image: Tensor) -> Tensor:
        """The pixels under the mask: (..., H, W) -> (..., P). Raises ValueError for an image of another size."""
        return pack(image, self.mask)

    def unpack(self, packed: Tensor) -> Tensor:
        """The inverse of `pack`, 0 outside the mask: (..., P) -> (..., H, W). Raises ValueError for another P."""
        return unpack(packed, self.mask)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a safetensors file with the fingerprints in its metadata."""
        metadata = {"format": _FORMAT, "names": json.dumps(self.names), "normal_coverage": str(self.normal_coverage)}
        metadata |= {key: getattr(self, key) for key in _ORIGIN}
        tensors = {"packed": self.packed, "mask": self.mask}
        if self.relative_errors is not None:
            tensors["relative_errors"] = self.relative_errors
        tensors = {key: tensor.cpu().contiguous() for key, tensor in tensors.items()}
        with writing(path) as temporary:
            save_file(tensors, temporary, metadata)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        library: MaterialLibrary | None = None,
        probe: LightProbe | None = None,
        view: View | None = None,
    ) -> "BasisImages":
        """Read what `save` wrote.

        library, probe, view  what the images must have been rendered with; None accepts any
        Raises ValueError where the file is something else or was rendered with another library, probe or view.
        """
        existing_file(path, "basis images, which `torchbrdf bake` writes (BasisImages.save in Python)")
        try:
            with safe_open(path, "pt") as file:
                metadata = file.metadata() or {}
                if metadata.get("format") != _FORMAT:
                    raise ValueError(f"{path}: not basis images of this version ({_FORMAT!r}); {_AGAIN}")
                tensors = {key: file.get_tensor(key) for key in list(file.keys())}
        except SafetensorError:
            raise ValueError(f"{path}: not basis images (truncated, damaged or another format)") from None
        try:
            _check_tensors(tensors)
            basis = cls(**tensors, **_fields(metadata))
        except ValueError as error:
            raise ValueError(f"{path}: damaged basis images: {error}; {_AGAIN}") from None
        expected = {
            "library": library is None or (library.source, library.names) == (basis.library, basis.names),
            "light probe": probe is None or probe.fingerprint == basis.probe,
            "view": view is None or view.fingerprint == basis.view,
        }
        for what, matches in expected.items():
            if not matches:
                raise ValueError(f"{path}: rendered with another {what}; {_AGAIN} with this one")
        return basis


def own_images(packed: Tensor) -> Tensor:
    """(m, 3, P): every material as it is, R by its column of R and so on, of basis images (3 m, 3, P)."""
    return packed.unflatten(0, (-1, 3)).diagonal(dim1=1, dim2=2).movedim(-1, 1)


def _check_tensors(tensors: dict[str, Tensor]) -> None:
    """Raise ValueError where these are not what `save` writes; how they fit together is checked by BasisImages."""
    strange = sorted(tensors.keys() - _TYPES.keys()) or sorted({"packed", "mask"} - tensors.keys())
    if strange:
        raise ValueError(
            f"expected the tensors packed, mask and perhaps relative_errors; wrong or absent: {strange[0]!r}"
        )
    for key, tensor in tensors.items():
        if tensor.dtype != _TYPES[key]:
            raise ValueError(f"{key} must be {_TYPES[key]}, got {tensor.dtype}")
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise ValueError(f"{key} holds NaN or infinite values")
    mask = tensors["mask"]
    if mask.ndim != 3 or mask.shape[0] != 1 or not mask.any() or int(mask.view(torch.uint8).max()) > 1:
        raise ValueError(f"mask must be (1, H, W) of bytes 0 and 1, some of them 1, got {tuple(mask.shape)}")


def _fields(metadata: dict[str, str]) -> dict[str, Any]:
    """What `save` put into the metadata, as arguments of BasisImages; ValueError where something else is there."""
    absent = [key for key in ("names", *_ORIGIN) if key not in metadata]
    if absent:
        raise ValueError(f"its metadata has no {absent[0]!r}")
    try:
        names = json.loads(metadata["names"])
    except (ValueError, RecursionError):
        names = None
    try:
        coverage = float(metadata.get("normal_coverage", 1))
    except ValueError:
        coverage = math.nan
    if not (isinstance(names, list) and names and all(isinstance(name, str) for name in names)):
        raise ValueError("the names in its metadata must be a list of texts")
    if len(set(names)) < len(names):
        raise ValueError("two materials in its metadata have the same name")
    if not 0 <= coverage <= 1:
        raise ValueError("normal_coverage in its metadata must be 0 to 1")
    return {"names": tuple(names), "normal_coverage": coverage, **{key: metadata[key] for key in _ORIGIN}}
