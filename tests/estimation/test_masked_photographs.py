import re
import warnings

import pytest
import torch
from torch import Tensor

from torchbrdf.estimation.masked_photographs import check_observation
from torchbrdf.view.packing import Frames

MASK = torch.tensor([[[True, False, True], [True, True, False]]])
"""Four of 2 x 3 pixels."""

OTHER = torch.tensor([[[True], [True], [False], [True]]])
"""Three of 4 x 1 pixels."""

ONE, TWO = Frames((MASK,)), Frames((MASK, OTHER))


def photograph(*batch: int, size: tuple[int, int] = (2, 3), dtype: torch.dtype = torch.float32) -> Tensor:
    count = 3 * size[0] * size[1]
    for b in batch:
        count *= b
    return (torch.arange(count, dtype=dtype) + 1).reshape(*batch, 3, *size)


def refused(message: str, image: object, mask: object = None, frames: Frames = ONE) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        check_observation(image, mask, frames, several=len(frames.masks) > 1)  # type: ignore[arg-type]


class TestPacking:
    def test_pixels_of_the_mask_row_by_row(self):
        y, used, batch = check_observation(photograph(), None, ONE, several=False)
        assert y.tolist() == [[[1, 3, 4, 5], [7, 9, 10, 11], [13, 15, 16, 17]]]
        assert used.tolist() == [[True] * 4]
        assert batch == ()

    def test_pixels_not_used_are_zero(self):
        mask = torch.tensor([[[True, True, False], [True, True, True]]])
        y, used, _ = check_observation(photograph(), mask, ONE, several=False)
        assert used.tolist() == [[True, False, True, True]]
        assert y[0, 0].tolist() == [1, 0, 4, 5]

    @pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
    def test_values_that_are_not_used_do_not_matter(self, value: float):
        image = photograph()
        image[:, 0, 1] = value  # outside the view
        image[:, 0, 2] = value  # under the mask
        mask = torch.tensor([[[True, True, False], [True, True, True]]])
        y, _, _ = check_observation(image, mask, ONE, several=False)
        assert y[0, 0].tolist() == [1, 0, 4, 5]

    @pytest.mark.parametrize("batch", [(), (2,), (2, 3), (0,)])
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    def test_batches_and_precision(self, batch: tuple[int, ...], dtype: torch.dtype):
        y, used, shape = check_observation(photograph(*batch, dtype=dtype), None, ONE, several=False)
        count = torch.Size(batch).numel()
        assert y.shape == (count, 3, 4)
        assert used.shape == (count, 4)
        assert (y.dtype, used.dtype, shape) == (dtype, torch.bool, batch)

    def test_a_mask_for_each_or_for_all(self):
        masks = torch.ones(2, 1, 2, 3, dtype=torch.bool)
        masks[1, 0, 1] = False
        _, used, _ = check_observation(photograph(2), masks, ONE, several=False)
        assert used.tolist() == [[True] * 4, [True, True, False, False]]
        _, used, _ = check_observation(photograph(2), masks[1], ONE, several=False)
        assert used.tolist() == [[True, True, False, False]] * 2

    def test_other_memory_layouts(self):
        image = photograph(2)
        strange = image.to(memory_format=torch.channels_last)
        pair = [check_observation(one, None, ONE, several=False)[0] for one in (image, strange)]
        assert torch.equal(pair[0], pair[1])
        assert pair[1].is_contiguous()

    def test_gradient_reaches_the_used_pixels_only(self):
        image = photograph().requires_grad_()
        mask = torch.tensor([[[True, True, False], [True, True, True]]])
        check_observation(image, mask, ONE, several=False)[0].sum().backward()
        assert image.grad is not None
        assert image.grad[0].tolist() == [[1, 0, 0], [1, 1, 0]]

    def test_two_photographs_one_behind_the_other(self):
        images = [photograph(), 100 + photograph(size=(4, 1))]
        mask = torch.tensor([[[True], [False], [True], [True]]])
        y, used, batch = check_observation(images, [None, mask], TWO, several=True)
        assert y[0, 0].tolist() == [1, 3, 4, 5, 101, 0, 104]
        assert used.tolist() == [[True] * 4 + [True, False, True]]
        assert batch == ()


class TestRefused:
    def test_sizes(self):
        message = "image must be (*batch, 3, 2, 3) like the basis images, got "
        refused(message + "(3, 2, 4)", photograph(size=(2, 4)))
        refused(message + "(2, 3)", torch.ones(2, 3))
        refused(message + "(1, 2, 3)", torch.ones(1, 2, 3))

    def test_precision(self):
        message = "image must be float32 or float64 linear radiance, got torch."
        for dtype in (torch.bfloat16, torch.float16):
            refused(message + f"{str(dtype)[6:]}; hand it image.float()", photograph().to(dtype))
        decode = (
            "; pictures of whole numbers are encoded for displays, and dividing by 255 does not make them linear: "
            "decode the file, torchbrdf.read_image(path, allow_ldr=True)"
        )
        for dtype in (torch.uint8, torch.int64, torch.bool):
            refused(message + str(dtype)[6:] + decode, photograph().to(dtype))

    def test_not_a_tensor(self):
        refused("image must be a tensor (*batch, 3, H, W), got ndarray; see torch.from_numpy", photograph().numpy())

    def test_masks(self):
        refused("mask must be bool (1, 2, 3), got torch.float32 (1, 2, 3)", photograph(), MASK.float())
        refused("mask must be bool (1, 2, 3) or (5, 1, 2, 3), got torch.bool (2, 3)", photograph(5), MASK[0])
        refused(
            "mask must be bool (1, 2, 3) or (5, 1, 2, 3), got torch.bool (4, 1, 2, 3)",
            photograph(5),
            MASK.expand(4, 1, 2, 3),
        )

    def test_values(self):
        image = photograph()
        image[0, 0, 0] = float("nan")
        image[1:, 1, 1] = float("inf")
        message = "image holds NaN or infinite values, in 2 of the 4 pixels under the mask; mask them out"
        refused(message, image)
        refused(message, image, MASK)

    def test_values_of_a_batch_say_where(self):
        """Pixels, not values; where a photograph has none left, it is that which counts."""
        images, message = photograph(2, 3), "image holds NaN or infinite values at index "
        images[0, 1, :, 0, 0] = float("nan")
        refused(message + "(0, 1) of a batch of 2 x 3, in 1 of the 4 pixels under the mask; mask them out", images)
        images[1, 2] = float("inf")
        end = " of the 4 pixels under the mask; whatever made it has diverged"
        refused(message + "(1, 2) of a batch of 2 x 3, in 4" + end, images)
        many = photograph(9)
        many[2:8, 1] = float("nan")
        refused(
            message + "2, 3, 4 and 3 more of a batch of 9, in 24 of the 24 pixels under the mask; whatever made it has "
            "diverged",
            many,
        )

    def test_values_of_several_photographs_say_in_which(self):
        pair = [photograph(2), photograph(2, size=(4, 1))]
        pair[1][1, 2, 0] = float("nan")
        message = "image holds NaN or infinite values in entry 1 of the list"
        end = ", in 1 of the 3 pixels under the mask; mask them out"
        refused(f"{message} at index 1 of a batch of 2{end}", pair, frames=TWO)
        refused(message + end, [one[1] for one in pair], frames=TWO)
        pair[0][0] = float("inf")
        refused(
            "image holds NaN or infinite values in entry 0 of the list at index 0 of a batch of 2, in 4 of the 4 "
            "pixels under the mask; whatever made it has diverged",
            pair,
            frames=TWO,
        )

    def test_no_pixel_left(self):
        message = "mask leaves no pixel of the view to use"
        refused(message, photograph(), torch.zeros_like(MASK))
        refused(message, photograph(), ~MASK)
        masks = torch.stack([MASK, ~MASK, ~MASK])
        refused(message + " at index 1, 2 of a batch of 3", photograph(3), masks)

    def test_black(self):
        image = photograph(2)
        image[1] = 0
        image[1, :, 0, 1] = 9  # outside the view
        refused("image is black at index 1 of a batch of 2: every pixel under the mask is 0", image)
        image = photograph()
        image[:, 1] = 0
        mask = torch.tensor([[[False, True, False], [True, True, True]]])
        refused("image is black: every pixel under the mask is 0", image, mask)

    def test_numbers_of_photographs(self):
        message = "this estimator is of 2 photographs of one material: pass a list of 2, one for each basis, got "
        refused(message + "one Tensor", photograph(), frames=TWO)
        refused(message + "one Tensor", torch.stack([photograph()] * 2), frames=TWO)
        refused(message + "one int", 3, frames=TWO)
        refused(message + "1", [photograph()], frames=TWO)
        refused(message + "3", [photograph()] * 3, frames=TWO)
        pair = [photograph(), photograph(size=(4, 1))]
        refused("expected a mask or None for each of 2 photographs, got 1", pair, [None], frames=TWO)
        message = (
            "image must be one tensor (*batch, 3, H, W), got a {} of {}; several photographs of one material need an "
            "estimator of as many basis images"
        )
        refused(message.format("list", 1), [photograph()])
        refused(message.format("tuple", 2), tuple(pair))

    def test_photographs_that_do_not_belong_together(self):
        message = "the photographs of one material must share batch axes and precision"
        refused(message, [photograph(2), photograph(3, size=(4, 1))], frames=TWO)
        refused(message, [photograph(), photograph(size=(4, 1)).double()], frames=TWO)

    def test_vmap(self):
        with pytest.raises(RuntimeError, match=r"^torch\.func\.vmap is not supported: pass the whole batch"):
            torch.func.vmap(lambda image: check_observation(image, None, ONE, several=False)[0])(photograph(2))


class TestDoubtfulPhotographs:
    def test_mostly_negative(self):
        images = photograph(3)
        images[1] *= -1
        message = "^image is mostly negative at index 1 of a batch of 3, which no radiance is"
        with pytest.warns(UserWarning, match=message) as warned:
            check_observation(images, None, ONE, several=False)
        assert len(warned) == 1

    @pytest.mark.parametrize("scale", [1e-30, 1, 1e30])
    def test_noise_below_zero_is_silent(self, scale: float):
        image = photograph() * scale
        image[:, 0] *= -0.1
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_observation(image, None, ONE, several=False)

    def test_channels_last(self):
        expected = "image must be (*batch, 3, 2, 3) like the basis images, got (5, 2, 3, 3)"
        refused(f"{expected}; permute it: image.movedim(-1, -3)", photograph(5).movedim(-3, -1))

    def test_a_mask_of_a_single_photograph_has_one_shape(self):
        refused("mask must be bool (1, 2, 3), got torch.bool (2, 3)", photograph(), MASK[0])
        refused("mask must be bool (1, 2, 3) or (5, 1, 2, 3), got torch.bool (2, 3)", photograph(5), MASK[0])

    def test_a_mask_of_numpy(self):
        refused("mask must be a tensor of bool, got ndarray; see torch.from_numpy", photograph(), MASK.numpy())
