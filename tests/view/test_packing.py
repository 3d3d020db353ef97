"""Images packed over a mask: what has another size is no image of it."""

import pytest
import torch

from torchbrdf.view.packing import Frames, pack, unpack

MASK = torch.tensor([[[True, False, True], [False, True, True]]])


@pytest.mark.parametrize("shape", [(3, 4, 6), (3, 2, 4), (3, 3, 2), (3, 1, 2), (6,), ()])
def test_an_image_of_another_size_is_refused(shape: tuple[int, ...]):
    """A larger one would give pixels of other places."""
    message = rf"an image to pack must be \(\.\.\., 2, 3\) as the mask is, got \({', '.join(map(str, shape))},?\)"
    for call in (lambda image: pack(image, MASK), lambda image: Frames((MASK,)).pack([image])):
        with pytest.raises(ValueError, match=f"^{message}$"):
            call(torch.zeros(shape))


@pytest.mark.parametrize("shape", [(3, 5), (3, 3), (2, 1), ()])
def test_values_of_another_mask_are_refused(shape: tuple[int, ...]):
    message = rf"values to unpack must be \(\.\.\., 4\) of this mask, got \({', '.join(map(str, shape))},?\)"
    with pytest.raises(ValueError, match=f"^{message}$"):
        unpack(torch.zeros(shape), MASK)
