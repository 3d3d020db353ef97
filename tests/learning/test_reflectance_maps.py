"""Training data made on the fly: images are Y w, batches are reproducible, workers agree."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from kornia.augmentation import AugmentationSequential
from scipy.stats import beta
from torch import Tensor
from torch.utils.data import BatchSampler, DataLoader, RandomSampler, SequentialSampler

from torchbrdf import BasisImages, SphereView
from torchbrdf.learning.augment import RandomSensorNoise, RandomSilhouetteErosion, photograph_defects
from torchbrdf.learning.reflectance_maps import Blending, ReflectanceMaps

SIZE = 16
VIEW = SphereView(SIZE)
NAMES = tuple(f"material-{i}" for i in range(6))


def basis(seed: int = 0) -> BasisImages:
    """Positive noise: no row is like another."""
    generator = torch.Generator().manual_seed(seed)
    packed = torch.rand(18, 3, len(VIEW.pixels), generator=generator) + 0.1
    return BasisImages(packed, VIEW.mask, NAMES, "library", f"probe {seed}", VIEW.fingerprint)


def equal(one: dict[str, Tensor], other: dict[str, Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)


def test_clean_images_are_the_weights_images():
    lights = [basis(0), basis(1), basis(2)]
    batch = ReflectanceMaps(lights)[list(range(40))]
    assert {name: tuple(value.shape) for name, value in batch.items()} == {
        "image": (40, 3, SIZE, SIZE),
        "mask": (40, 1, SIZE, SIZE),
        "clean": (40, 3, SIZE, SIZE),
        "weights": (40, 18, 3),
        "light": (40,),
    }
    assert sorted(set(batch["light"].tolist())) == [0, 1, 2]
    for image, weights, light in zip(batch["clean"], batch["weights"], batch["light"], strict=True):
        y = lights[int(light)]
        torch.testing.assert_close(image, y.unpack(torch.einsum("nc,ncp->cp", weights, y.packed)))
    assert torch.equal(batch["image"], batch["clean"])
    assert torch.equal(batch["mask"], VIEW.mask.expand(40, -1, -1, -1))
    assert bool((batch["clean"] >= 0).all())
    assert bool((batch["clean"][:, :, ~VIEW.mask[0]] == 0).all())


def test_weights_of_plain_blends():
    """Without factors the weights of each channel add up to 1; convex ones are never negative, affine ones at times."""
    plain = Blending(materials=3, beyond=0, brightness=0, tint=0, swap_colours=False)
    weights = ReflectanceMaps(basis(), blending=plain)[list(range(200))]["weights"]
    torch.testing.assert_close(weights.sum(1), torch.ones(200, 3))
    assert bool((weights >= 0).all())
    for channel in range(3):
        others = [column for column in range(18) if column % 3 != channel]
        assert bool((weights[:, others, channel] == 0).all())
    counts = set((weights[..., 0] > 0).sum(1).tolist())
    assert counts == {1, 2, 3}
    affine = ReflectanceMaps(basis(), blending=replace(plain, beyond=0.5))[list(range(200))]["weights"]
    torch.testing.assert_close(affine.sum(1), torch.ones(200, 3))
    assert 0.1 < float((affine < 0).any(2).any(1).float().mean()) < 0.9
    assert float(affine.min()) >= -0.5 / 2
    alone = ReflectanceMaps(basis(), blending=replace(plain, materials=1, beyond=1))[list(range(50))]["weights"]
    assert torch.equal(alone.amax(1), torch.ones(50, 3))


@pytest.mark.parametrize("evenness", [0.2, 0.05, 0.02, 1e-3, 1e-6])
def test_uneven_blends_are_whole(evenness: float):
    """Half of them are of one material; the first share of the others has a beta distribution."""
    plain = Blending(materials=2, evenness=evenness, beyond=0, brightness=0, tint=0, swap_colours=False)
    maps = ReflectanceMaps(basis(), blending=plain)
    weights = maps[list(range(2000))]["weights"][..., 0]
    torch.testing.assert_close(weights.sum(1), torch.ones(2000))
    assert bool((weights >= 0).all())
    mixed = float((weights.amax(1) < 0.9).float().mean())
    share = beta(evenness, evenness)
    expected = float(share.cdf(0.9) - share.cdf(0.1)) / 2
    assert mixed == pytest.approx(expected, abs=4 * (expected / 2000) ** 0.5)
    assert torch.equal(maps[list(range(2000))]["weights"][..., 0], weights)


def test_negative_radiance_falls_back():
    """Materials that differ a hundredfold: extrapolated beyond the dark one they would be negative."""
    one = basis()
    dark = replace(one, packed=one.packed * torch.tensor([100.0, 1.0]).repeat_interleave(9)[:, None, None])
    batch = ReflectanceMaps(dark, blending=Blending(materials=2, beyond=3))[list(range(300))]
    assert bool((batch["clean"] >= 0).all())
    assert bool((batch["weights"] < 0).any())
    image = dark.unpack(torch.einsum("bnc,ncp->bcp", batch["weights"], dark.packed))
    torch.testing.assert_close(batch["clean"], image, atol=1e-3, rtol=1e-4)


def test_factors_and_colours():
    single = Blending(materials=1, brightness=0.5, tint=0, swap_colours=False)
    gain = ReflectanceMaps(basis(), blending=single)[list(range(400))]["weights"].sum(1)
    torch.testing.assert_close(gain, gain[:, :1].expand(400, 3))
    assert float(gain.log2().std()) == pytest.approx(0.5, rel=0.15)
    tinted = ReflectanceMaps(basis(), blending=replace(single, brightness=0, tint=0.3))[list(range(400))]
    assert float(tinted["weights"].sum(1).log2().std()) == pytest.approx(0.3, rel=0.1)
    swapped = ReflectanceMaps(basis(), blending=replace(single, swap_colours=True))[list(range(400))]["weights"]
    colours = [tuple(int(x) % 3 for x in one.argmax(0)) for one in swapped]
    assert len(set(colours)) == 6
    assert all(sorted(colour) == [0, 1, 2] for colour in colours)


def test_a_batch_depends_on_seed_epoch_and_indices():
    maps = ReflectanceMaps(basis(), RandomNoise(), seed=3)
    state = torch.random.get_rng_state()
    first = maps[[4, 7, 1]]
    assert torch.equal(torch.random.get_rng_state(), state)  # the caller's random numbers are its own
    torch.manual_seed(99)
    assert equal(maps[[4, 7, 1]], first)
    assert not equal(maps[[4, 7, 2]], first)
    assert not equal(ReflectanceMaps(basis(), RandomNoise(), seed=4)[[4, 7, 1]], first)
    maps.set_epoch(1)
    assert not equal(maps[[4, 7, 1]], first)
    maps.set_epoch(0)
    assert equal(maps[[4, 7, 1]], first)
    assert equal(maps[5], {name: value[0] for name, value in maps[[5]].items()})
    assert equal(maps[-1], maps[len(maps) - 1])
    listed = maps.__getitems__([4, 7, 1])
    assert all(equal(one, {name: value[i] for name, value in first.items()}) for i, one in enumerate(listed))


class RandomNoise:
    """Draws from the global generator, as kornia does."""

    def __call__(self, image: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        return image + torch.rand_like(image), mask & (torch.rand(mask.shape) > 0.1)


def batches(workers: int, collate: bool, seed: int = 0) -> list[dict[str, Tensor]]:
    maps = ReflectanceMaps([basis(0), basis(1)], RandomNoise(), length=24, seed=seed)
    order = RandomSampler(maps, generator=torch.Generator().manual_seed(1))
    if collate:
        return list(DataLoader(maps, 8, sampler=order, num_workers=workers))
    return list(DataLoader(maps, None, sampler=BatchSampler(order, 8, False), num_workers=workers))


def test_any_number_of_workers_gives_the_same():
    alone = batches(0, collate=True)
    assert len(alone) == 3
    assert not equal(alone[0], alone[1])
    for workers, collate in ((0, False), (2, True), (2, False)):
        found = batches(workers, collate)
        assert all(equal(one, other) for one, other in zip(found, alone, strict=True)), (workers, collate)


def test_workers_that_persist_see_the_epoch():
    maps = ReflectanceMaps(basis(), length=8)
    loader = DataLoader(maps, 4, num_workers=1, persistent_workers=True)
    first, again = list(loader), list(loader)
    assert all(equal(one, other) for one, other in zip(first, again, strict=True))
    maps.set_epoch(1)
    assert not equal(next(iter(loader)), first[0])


def test_defects_of_photographs():
    maps = ReflectanceMaps(basis(), photograph_defects(VIEW, known=True))
    batch = maps[list(range(16))]
    assert batch["mask"].dtype == torch.bool
    assert not torch.equal(batch["image"], batch["clean"])
    assert bool((batch["mask"] <= VIEW.mask).all())
    assert not bool(batch["mask"].flatten(1).all())
    assert equal(maps[list(range(16))], batch)
    loader = DataLoader(maps, None, sampler=BatchSampler(SequentialSampler(maps), 16, False), num_workers=1)
    torch.testing.assert_close(next(iter(loader)), batch)


@pytest.mark.parametrize("same_on_batch", [False, True])
def test_draws_are_the_same_in_any_default_type(same_on_batch: bool):
    clean = basis()

    def sample() -> dict[str, Tensor]:
        silhouette = RandomSilhouetteErosion(VIEW, p=0.5, same_on_batch=same_on_batch)
        defects = AugmentationSequential(photograph_defects(VIEW), silhouette, data_keys=["input", "mask"])
        return ReflectanceMaps(clean, defects, seed=1)[:16]

    expected = sample()
    torch.set_default_dtype(torch.float64)
    try:
        found = sample()
    finally:
        torch.set_default_dtype(torch.float32)
    assert equal(found, expected)


def test_noise_has_its_size():
    spoil = RandomSensorNoise((0.1, 0.1), (0.0, 0.0))
    batch = ReflectanceMaps(basis(), lambda image, mask: (spoil(image), mask))[list(range(64))]
    noise = batch["image"] - batch["clean"]
    lit = batch["clean"] * batch["clean"].mean((1, 2, 3), keepdim=True)
    inside = VIEW.mask.expand_as(noise)
    assert float((noise[inside] / lit[inside].sqrt()).std()) == pytest.approx(0.1, rel=0.02)
    assert math.isfinite(float(noise.sum()))


def test_repr():
    assert repr(ReflectanceMaps([basis(), basis(1)], length=9, seed=2)).startswith(
        "ReflectanceMaps(6 materials, 2 lights, 16 x 16, length=9, seed=2, Blending(materials=3"
    )


BAD = {
    "basis is an empty sequence; give the basis images of at least one light": lambda: ReflectanceMaps([]),
    "basis images must share library and mask; render them for the same": lambda: ReflectanceMaps(
        [basis(), replace(basis(1), library="another")]
    ),
    "length must be at least one sample and whole, got 0": lambda: ReflectanceMaps(basis(), length=0),
    "spoil takes images and masks, and RandomSensorNoise images alone; put it in": lambda: ReflectanceMaps(
        basis(), RandomSensorNoise()
    ),
    "spoil takes images and masks, which this AugmentationSequential does not": lambda: ReflectanceMaps(
        basis(), AugmentationSequential(RandomSensorNoise())
    ),
    "materials must be at least 1 and whole, got 0": lambda: Blending(materials=0),
    "length must be at least one sample and whole, got 3.5": lambda: ReflectanceMaps(basis(), length=3.5),
    "materials must be at least 1 and whole, got 2.5": lambda: Blending(materials=2.5),
    "evenness must be above 0, got 0": lambda: Blending(evenness=0),
    "tint must be at least 0 and finite, got -1": lambda: Blending(tint=-1),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_input(message: str):
    with pytest.raises(ValueError, match=message):
        BAD[message]()


@pytest.mark.parametrize(
    ("spoil", "got"),
    [
        (lambda image, mask: image, "two tensors, images and masks, got Tensor"),  # of two photographs: no pair
        (lambda image, mask: (image, mask, mask), "two tensors, images and masks, got 3 values"),
        (lambda image, mask: (image, None), "two tensors, images and masks, got 2 values"),
        (lambda image, mask: (image, mask.float()), r"bool, got \(2, 3, 16, 16\) and torch.float32 \(2, 1, 16, 16\)"),
        (lambda image, mask: (image[:1], mask), r"images \(2, 3, H, W\) and masks .*, got \(1, 3, 16, 16\) and torch"),
        (lambda image, mask: (image[..., :8], mask), r"got \(2, 3, 16, 8\) and torch.bool \(2, 1, 16, 16\)"),
    ],
)
def test_what_spoil_returns_is_checked(spoil: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]], got: str):
    maps = ReflectanceMaps(basis(), spoil)
    with pytest.raises(ValueError, match=f"^spoil must return .*{got}"):
        maps[[0, 1]]


def test_defects_may_change_the_size():
    halved = ReflectanceMaps(basis(), lambda image, mask: (image[..., ::2, ::2], mask[..., ::2, ::2]))[[0, 1]]
    assert (halved["image"].shape, halved["mask"].shape) == ((2, 3, 8, 8), (2, 1, 8, 8))


def test_slices_and_tensors_are_lists():
    maps = ReflectanceMaps(basis(), length=5)
    for index in (slice(0, 3), torch.arange(3), range(3), (0, 1, 2), torch.tensor([0, -4, 2]), np.arange(3)):
        assert equal(maps[index], maps[[0, 1, 2]])
    assert equal(maps[torch.tensor(2)], maps[2])
    assert len(maps[1:]["image"]) == 4


@pytest.mark.parametrize(
    ("index", "error", "message"),
    [
        ([], ValueError, "no index is given; ask for one sample at least"),
        (slice(9, 12), ValueError, "no index is given"),
        ([0, 5], IndexError, "index 5 of 5 samples"),
        ([0, -6], IndexError, "index -6 of 5 samples"),
        (torch.tensor([0.0]), ValueError, "indices of samples must be whole numbers, got 0.0"),
        (torch.tensor([True, False]), ValueError, "indices of samples must be whole numbers, got True"),
        ("a", ValueError, "indices of samples must be whole numbers, got 'a'"),
    ],
)
def test_indices_of_no_samples(index: object, error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        ReflectanceMaps(basis(), length=5)[index]


def test_index_out_of_range():
    with pytest.raises(IndexError, match="index 9 of 9 samples"):
        ReflectanceMaps(basis(), length=9)[9]
