"""Pixels of a ball are images of an eighth of them."""

import pytest
import torch
from torch import pi

from torchbrdf.transport.harmonic._mirror_images import MirrorImages, azimuths_of_images
from torchbrdf.transport.harmonic.ring_lookup import _copied
from torchbrdf.view import NormalMapView, SphereView


@pytest.mark.parametrize("view", [SphereView(9), SphereView(16), SphereView(16, fov_deg=12.0)], ids=str)
def test_normals_of_a_pixel_are_those_of_its_source_in_the_image(view):
    images = MirrorImages.of(view)
    middle = torch.full((1, 1), 0.5, dtype=torch.float64)

    def normals(pixels):
        return view.surface(pixels, middle.expand(len(pixels), 1), middle.expand(len(pixels), 1)).normals[..., 0]

    own, (x, y, z) = normals(view.pixels), normals(images.pixels)[:, images.source]
    azimuth = torch.atan2(y, x) * (1 - 2 * (images.image % 2)) + (images.image // 2).double() * (pi / 2)
    turned = torch.stack([torch.hypot(x, y) * torch.cos(azimuth), torch.hypot(x, y) * torch.sin(azimuth), z])
    assert torch.allclose(own, turned, atol=1e-12)


def test_an_eighth_of_the_pixels_is_enough_for_a_ball():
    view = SphereView(64)
    assert len(MirrorImages.of(view).pixels) < len(view.pixels) / 8 * 1.1


def test_other_shapes_have_no_images():
    view = NormalMapView(torch.nn.functional.normalize(torch.rand(3, 4, 4) + 0.1, dim=0), torch.ones(1, 4, 4).bool())
    images = MirrorImages.of(view)
    assert torch.equal(images.pixels[images.source], view.pixels)
    assert not images.image.any()


def test_azimuths_of_images():
    places = 12
    at = azimuths_of_images(places)
    azimuth = (torch.arange(places) + 0.5) * (2 * pi / places)
    for which in range(8):
        wanted = (1 - 2 * (which % 2)) * azimuth + (which // 2) * (pi / 2)
        found = (at[which] + 0.5) * (2 * pi / places)
        assert torch.allclose(torch.remainder(found - wanted + 1, 2 * pi), torch.ones(places), atol=1e-6)


def test_a_source_without_entries_has_images_without():
    image, entry, offsets = _copied(torch.tensor([0, 0]), torch.tensor([0, 0, 1]), torch.tensor([3, 4, 5]))
    assert image.tolist() == [3, 3, 4, 4]
    assert entry.tolist() == [0, 1, 0, 1]
    assert offsets.tolist() == [0, 2, 4]
