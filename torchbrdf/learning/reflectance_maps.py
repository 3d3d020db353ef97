"""Training data: reflectance maps of random combinations of basis BRDFs, spoilt as photographs are, made on the fly.

A reflectance map is Y w [CBP21, eq. 4], so that a sample costs a weighted sum of a few rows of basis images, not a
rendering. What spoils it is any callable on batches of images and masks, such as those of `torchbrdf.learning`.
"""

import hashlib
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from kornia.augmentation import AugmentationBase2D, AugmentationSequential
from kornia.constants import DataKey
from torch import Tensor
from torch.utils.data import Dataset

from torchbrdf.arguments import several
from torchbrdf.lasting import without_autocast
from torchbrdf.transport import BasisImages
from torchbrdf.view import unpack

_LEAST_TOTAL = 1e-12
"""Of the shares that are kept, below which they say nothing of each other."""

_LEAST_EVENNESS = 0.05
"""Below it PyTorch's Dirichlet draws underflow: at 0.001 one in eight has equal shares."""

Spoil = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""From images (B, 3, H, W) and masks (B, 1, H, W) bool to what the network gets, in the same shapes."""


@dataclass(frozen=True)
class Blending:
    """How random materials are made of those of a library.

    materials    most of them in one blend; 1 for the library's own
    evenness     parameter of the symmetric Dirichlet distribution of their shares; below 1 one of them prevails
    beyond       largest extrapolation e: shares s become s + e (s - mean), still 1 in total, some of them negative.
                 A sample with negative radiance anywhere falls back to its shares between 0 and 1
    brightness   standard deviation in stops of a factor of all channels
    tint         standard deviation in stops of a factor of each channel beside that
    swap_colours whether R, G and B of the materials change places: a red plastic makes a blue one
    """

    materials: int = 3
    evenness: float = 0.5
    beyond: float = 0.2
    brightness: float = 0.3
    tint: float = 0.2
    swap_colours: bool = True

    def __post_init__(self) -> None:
        """Check the values."""
        if self.materials < 1 or self.materials != int(self.materials):
            raise ValueError(f"materials must be at least 1 and whole, got {self.materials}")
        if not self.evenness > 0:
            raise ValueError(f"evenness must be above 0, got {self.evenness}")
        for name in ("beyond", "brightness", "tint"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"{name} must be at least 0 and finite, got {getattr(self, name)}")


class ReflectanceMaps(Dataset[dict[str, Tensor]]):
    """Samples of random materials under random ones of some lights.

    basis     basis images of one library and view; a sequence of them for several probes or rotations
    spoil     what is done to batches of clean images (B, 3, H, W) and masks (B, 1, H, W) bool, and returns both; of
              kornia an `AugmentationSequential(..., data_keys=["input", "mask"])`. None for nothing
    length    samples an epoch
    seed      samples depend on it, on the epoch and on the indices asked for at once, not on the number of workers
    blending  how materials are mixed, tinted and brightened; None for `Blending()`

    A sample is a dict of
        image    (3, H, W)  what a network gets
        mask     (1, H, W)  bool, True = use
        clean    (3, H, W)  Y w, 0 outside the view
        weights  (n, 3)     w
        light    ()         int64, which of the basis images
    A list or tensor of indices, or a slice, gives a batch of them at once, many times faster than one by one. So
    `DataLoader(maps, 64)` asks, and then collates; with `sampler=BatchSampler(...)` and `batch_size=None` it passes
    batches on as they are. IndexError for an index beyond `length`; ValueError for what is no index, or none at all.
    """

    def __init__(
        self,
        basis: BasisImages | Sequence[BasisImages],
        spoil: Spoil | None = None,
        length: int = 1 << 16,
        seed: int = 0,
        blending: Blending | None = None,
    ) -> None:
        """Check that the basis images belong together, and share them with workers."""
        lights = several("ReflectanceMaps", "basis", basis, BasisImages)
        if not lights:
            raise ValueError("basis is an empty sequence; give the basis images of at least one light")
        first = lights[0]
        for one in lights[1:]:
            if (one.library, one.names) != (first.library, first.names) or not torch.equal(one.mask, first.mask):
                raise ValueError("basis images must share library and mask; render them for the same library and view")
        _check_spoil(spoil)
        if length < 1 or length != int(length):
            raise ValueError(f"length must be at least one sample and whole, got {length}")
        self.names, self.mask, self.lights = first.names, first.mask, len(lights)
        self.spoil, self.length, self.seed = spoil, length, seed
        self.blending = Blending() if blending is None else blending
        rows = [one.packed.detach().flatten(0, 1) for one in lights]
        self._rows = rows[0] if len(rows) == 1 else torch.cat(rows)
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()  # workers that persist see it change

    def __repr__(self) -> str:
        """Sizes and settings."""
        height, width = self.mask.shape[-2:]
        return (
            f"ReflectanceMaps({len(self.names)} materials, {self.lights} lights, {height} x {width}, "
            f"length={self.length}, seed={self.seed}, {self.blending})"
        )

    def __len__(self) -> int:
        """Samples an epoch."""
        return self.length

    def set_epoch(self, epoch: int) -> None:
        """Make other samples of the same indices, in running workers, too."""
        self._epoch.fill_(epoch)

    def __getitem__(self, index: int | slice | Sequence[int] | Tensor | np.ndarray) -> dict[str, Tensor]:
        """A sample, or a batch of samples for a slice, a list, a tensor or an array of indices."""
        if isinstance(index, slice):
            index = range(self.length)[index]
        elif isinstance(index, Tensor | np.ndarray):
            index = index.tolist()
        if isinstance(index, Sequence):
            return self._batch(index)
        return {name: value[0] for name, value in self._batch([index]).items()}

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, Tensor]]:
        """The samples of one batch, as `DataLoader` asks for them."""
        batch = self._batch(indices)
        return [{name: value[i] for name, value in batch.items()} for i in range(len(indices))]

    def _checked(self, index: int) -> int:
        """From 0 on."""
        if isinstance(index, bool) or not hasattr(index, "__index__"):
            raise ValueError(f"indices of samples must be whole numbers, got {index!r}")
        i = operator.index(index)
        if not -self.length <= i < self.length:
            raise IndexError(f"index {i} of {self.length} samples")
        return i % self.length

    def _batch(self, asked: Sequence[int]) -> dict[str, Tensor]:
        indices = [self._checked(index) for index in asked]
        if not indices:
            raise ValueError("no index is given; ask for one sample at least")
        key = f"{self.seed} {int(self._epoch)} {indices}".encode()
        with torch.random.fork_rng(devices=[]):  # kornia draws from torch's global generator
            torch.manual_seed(int.from_bytes(hashlib.blake2b(key, digest_size=7).digest()))
            light = torch.randint(self.lights, (len(indices),))
            packed, weights = random_materials(self._rows, len(self.names), light, self.blending)
            clean = unpack(packed, self.mask)
            image, mask = clean, self.mask.expand(len(indices), -1, -1, -1)
            if self.spoil is not None:
                image, mask = _checked_pair(self.spoil(clean, mask), len(indices))
        return {"image": image, "mask": mask, "clean": clean, "weights": weights, "light": light}


def _check_spoil(spoil: object) -> None:
    """Raise ValueError for what is not called with images and masks, such as kornia's augmentations of images alone."""
    if spoil is not None and (not callable(spoil) or isinstance(spoil, type)):
        what = spoil.__name__ if isinstance(spoil, type) else type(spoil).__name__
        raise ValueError(f"spoil must be called with images and masks, as photograph_defects(view) is, got {what}")
    paired = 'AugmentationSequential(..., data_keys=["input", "mask"])'
    if isinstance(spoil, AugmentationBase2D):
        raise ValueError(f"spoil takes images and masks, and {type(spoil).__name__} images alone; put it in {paired}")
    if isinstance(spoil, AugmentationSequential) and spoil.data_keys != [DataKey.INPUT, DataKey.MASK]:
        raise ValueError(f"spoil takes images and masks, which this AugmentationSequential does not; make it {paired}")


def _checked_pair(spoilt: object, count: int) -> tuple[Tensor, Tensor]:
    """The images and masks that `spoil` returned, `count` of each."""
    if not (isinstance(spoilt, tuple | list) and len(spoilt) == 2 and all(isinstance(one, Tensor) for one in spoilt)):
        got = f"{len(spoilt)} values" if isinstance(spoilt, tuple | list) else type(spoilt).__name__
        raise ValueError(f"spoil must return two tensors, images and masks, got {got}")
    image, mask = spoilt
    size = tuple(image.shape[-2:])
    if image.shape != (count, 3, *size) or mask.shape != (count, 1, *size) or mask.dtype != torch.bool:
        raise ValueError(
            f"spoil must return images ({count}, 3, H, W) and masks ({count}, 1, H, W) bool, "
            f"got {tuple(image.shape)} and {mask.dtype} {tuple(mask.shape)}"
        )
    return image, mask


@without_autocast
def random_materials(rows: Tensor, n_materials: int, light: Tensor, blending: Blending) -> tuple[Tensor, Tensor]:
    """Random materials from torch's global generator, under given lights.

    rows     (lights * n * 3, P)  basis images, one light behind the other
    light    (B,)  int64
    returns  images (B, 3, P) and weights (B, n, 3)
    """
    count, n = len(light), 3 * n_materials
    k = min(blending.materials, n_materials)
    chosen = torch.rand(count, n_materials, dtype=torch.float32).topk(k).indices
    shares = _shares(count, k, blending.evenness)
    colours = torch.arange(3).expand(count, 3)
    if blending.swap_colours:
        colours = torch.rand(count, 3, dtype=torch.float32).argsort()
    brighter, tinted = (torch.randn(count, width, dtype=torch.float32) for width in (1, 3))
    stops = blending.brightness * brighter + blending.tint * tinted
    gain = torch.exp2(stops)

    column = 3 * chosen[:, :, None] + colours[:, None]  # (B, k, 3)
    row = (light[:, None, None] * n + column) * 3 + torch.arange(3)
    parts = rows.index_select(0, row.flatten()).view(count, k, 3, -1)

    used = shares > 0
    mean = 1 / used.sum(1, keepdim=True).float()
    beyond = blending.beyond * torch.rand(count, 1, dtype=torch.float32)
    extrapolated = torch.where(used, shares + beyond * (shares - mean), 0)
    images = torch.einsum("bk,bkcp->bcp", extrapolated, parts)
    negative = (images < 0).flatten(1).any(1)
    if bool(negative.any()):
        extrapolated[negative] = shares[negative]
        images[negative] = torch.einsum("bk,bkcp->bcp", shares[negative], parts[negative])
    weights = torch.zeros(count, n, 3, dtype=torch.float32)
    weights.scatter_(1, column, extrapolated[:, :, None] * gain[:, None])
    return images * gain[:, :, None], weights


def _shares(count: int, k: int, evenness: float) -> Tensor:
    """(count, k) float32: Dirichlet shares of the first 1 to k, 0 for the others, from torch's global generator."""
    shares = torch.distributions.Dirichlet(torch.full((k,), evenness, dtype=torch.float32)).sample((count,))
    used = torch.arange(k) < torch.randint(1, k + 1, (count, 1))
    total = (shares * used).sum(1, keepdim=True)
    lost = (total < _LEAST_TOTAL)[:, 0] | (evenness < _LEAST_EVENNESS)
    shares = shares * used / torch.where(lost[:, None], 1, total)
    if bool(lost.any()):
        # Shares do not depend on their total. log G(a) = log G(a + 1) + log(U) / a, far below what a float holds
        like = torch.full((int(lost.sum()), k), evenness, dtype=torch.float64)
        logarithms = torch._standard_gamma(like + 1).log() + torch.log1p(-torch.rand_like(like)) / like
        shares[lost] = logarithms.masked_fill(~used[lost], -torch.inf).softmax(1).float()
    return shares
