"""Normals in whatever way they are stored: decoded where that is certain, else refused."""

import warnings

import pytest
import torch

from paths import ROOT
from torchbrdf.images import write_image
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView

cv2 = pytest.importorskip("cv2")

BACKGROUNDS = [(0, 0, 0), (0.5, 0.5, 0.5), (1, 1, 1), (0.5, 0.5, 1), (float("nan"),) * 3]


def ball(size=24):
    sphere = SphereView(size)
    return sphere.normals, sphere.mask


def stored(size=24, background=(0, 0, 0)):
    """A ball as n/2 + 1/2."""
    normals, mask = ball(size)
    return torch.where(mask, normals / 2 + 0.5, torch.tensor(background, dtype=torch.float32)[:, None, None])


def read(numbers, **arguments):
    """The view, and what was said of it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        view = NormalMapView(numbers, **arguments)
    return view, [str(warning.message) for warning in caught]


def opened(path):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        view = NormalMapView.open(path)
    return view, [str(warning.message).removeprefix(f"{path}: ") for warning in caught]


def check_ball(view, size=24, within=1e-5):
    normals, mask = ball(size)
    assert torch.equal(view.mask, mask)
    assert float((view.normals - normals).abs().max()) < within


def write_png(path, image, depth):
    full = 2**depth - 1
    whole = (image.nan_to_num(0).clamp(0, 1) * full).round().permute(1, 2, 0).numpy().astype(f"uint{depth}")
    cv2.imwrite(str(path), whole[..., [2, 1, 0, *range(3, whole.shape[2])]])
    return path


@pytest.mark.parametrize("background", BACKGROUNDS)
@pytest.mark.parametrize("size", [8, 24, 64])
def test_encoded_normals_are_decoded_and_that_is_said(size, background):
    view, said = read(stored(size, background))
    check_ball(view, size)
    assert said[0] == "normal map: its numbers are n/2 + 1/2 and were decoded"


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("background", BACKGROUNDS[:4])
def test_png_files(tmp_path, depth, background):
    path = write_png(tmp_path / "n.png", stored(24, background), depth)
    view, said = opened(path)
    check_ball(view, within=0.008 if depth == 8 else 4e-5)
    assert said[0] == "its numbers are n/2 + 1/2 and were decoded"


def test_a_png_file_with_alpha(tmp_path):
    image = torch.cat([stored(24, (0.3, 0.6, 0.9)), ball()[1].float()])
    check_ball(opened(write_png(tmp_path / "n.png", image, 16))[0], within=4e-5)


@pytest.mark.parametrize("encoded", [False, True])
def test_exr_files(tmp_path, encoded):
    write_image(tmp_path / "n.exr", stored() if encoded else ball()[0])
    view, said = opened(tmp_path / "n.exr")
    check_ball(view)
    assert said == (["its numbers are n/2 + 1/2 and were decoded"] if encoded else [])


@pytest.mark.parametrize(
    ("store", "name"),
    [
        (lambda v: v * 255, "n/2 + 1/2 times 255"),
        (lambda v: v * 65535, "n/2 + 1/2 times 65535"),
        (lambda v: v**2.2, "n/2 + 1/2 to the power 2.2"),
        (lambda v: torch.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4), "with the sRGB curve undone"),
    ],
)
def test_other_ways_to_store_them(store, name):
    view, said = read(store(stored()))
    check_ball(view, within=1e-4)
    assert name in said[0]


def test_pixels_that_mix_normals_with_the_background_are_left_out():
    """A ball of twice the size, averaged over blocks of 2 x 2 together with black around it."""
    fine = stored(96)
    view, _ = read(torch.nn.functional.avg_pool2d(fine, 2))
    normals, mask = ball(48)
    extra = view.mask & ~mask
    assert int(extra.sum()) < 20
    assert float((view.normals - normals)[:, mask[0] & view.mask[0]].abs().max()) < 0.1


def test_unit_normals_are_taken_as_they_are():
    _, said = read(ball()[0])
    assert said == []


@pytest.mark.parametrize("background", [(1, 1, 1), (-1, -1, -1), (0.5, 0.5, 0.5), (0, 0, 1)])
def test_unit_normals_before_a_background(background):
    normals, mask = ball()
    view, _ = read(torch.where(mask, normals, torch.tensor(background, dtype=torch.float32)[:, None, None]))
    check_ball(view)


def test_means_over_pixels_are_shorter_and_sound():
    """As a renderer averages normals of a surface with many folds."""
    g = torch.Generator().manual_seed(0)
    fine = torch.nn.functional.normalize(ball(96)[0] + 0.5 * torch.randn(3, 96, 96, generator=g), dim=0) * ball(96)[1]
    view, said = read(torch.nn.functional.avg_pool2d(fine, 4))
    assert said == []
    assert float((view.normals * ball()[0]).sum(0)[ball()[1][0] & view.mask[0]].median()) > 0.95


@pytest.mark.parametrize("slope", [(0.5, 0.5), (-0.5, 0.25), (0.2, 0.9), (0.0, 1.0)])
def test_slopes_of_any_sign_are_brought_to_unit_length(slope):
    """(-p, -q, 1), all numbers between 0 and 1 or not."""
    y, x = torch.meshgrid(torch.linspace(1, 0, 9), torch.linspace(0, 1, 9), indexing="ij")
    slopes = torch.stack([slope[0] * x, slope[1] * y, torch.ones_like(x)])
    view, said = read(slopes)
    assert said == []
    torch.testing.assert_close(view.normals, torch.nn.functional.normalize(slopes, dim=0))


@pytest.mark.parametrize("normal", [(0.6, 0, 0.8), (1.0, 0.0, 1.0), (0.5, 0.0, 0.5), (1.0, 1.0, 1.0), (0.3, 0.3, 0.9)])
def test_a_single_plane_is_not_decoded(normal):
    view, said = read(torch.tensor(normal)[:, None, None].expand(3, 6, 6))
    assert said == []
    expected = torch.nn.functional.normalize(torch.tensor(normal), dim=0)
    torch.testing.assert_close(view.normals, expected[:, None, None].expand(3, 6, 6))


def test_normals_of_one_octant_are_not_decoded():
    normals = ball(32)[0][:, 3:15, 17:29]
    view, said = read(normals)
    assert said == []
    torch.testing.assert_close(view.normals, normals)


def test_a_flat_encoded_map_faces_the_camera():
    view, said = read(torch.tensor([128 / 255, 128 / 255, 1])[:, None, None].expand(3, 6, 6))
    assert "decoded" in said[0]
    assert float(view.normals[2].min()) > 0.999


@pytest.mark.parametrize("as_file", [False, True])
def test_pictures_are_no_normals(tmp_path, as_file):
    picture = torch.rand(3, 24, 24, generator=torch.Generator().manual_seed(0))
    path = write_png(tmp_path / "photo.png", picture, 8)
    with pytest.raises(ValueError, match=r"^[^\n]*its numbers are no known normals[^\n]*expected unit") as caught:
        NormalMapView.open(path) if as_file else NormalMapView(picture)
    assert not as_file or str(caught.value).startswith(f"{path}: ")


def test_files_of_vectors_of_any_length_are_refused_and_tensors_are_not(tmp_path):
    lengths = 0.2 + 3 * torch.rand(1, 24, 24, generator=torch.Generator().manual_seed(0))
    normals = ball()[0] * lengths
    check_ball(read(normals)[0])
    write_image(tmp_path / "n.exr", normals)
    with pytest.raises(ValueError, match=r"n\.exr: its numbers are no .* lengths of 0\.\d+ to 3\.\d+; expected"):
        NormalMapView.open(tmp_path / "n.exr")


@pytest.mark.parametrize(("factor", "said"), [(7, "all lengths are 7"), (None, "Z is 1")])
def test_files_of_one_length_and_of_slopes_are_read(tmp_path, factor, said):
    normals = ball()[0]
    write_image(tmp_path / "n.exr", normals * factor if factor else (normals / normals[2:]).nan_to_num())
    view, notes = opened(tmp_path / "n.exr")
    check_ball(view)
    assert said in notes[0]


def test_a_mask_says_which_pixels_count():
    numbers, mask = stored(24, (0.3, 0.9, 0.1)), ball()[1]
    check_ball(read(numbers, mask=mask)[0])


def test_files_of_the_field():
    path = ROOT.parent / "shared" / "field" / "n_encoded.exr"
    if not path.exists():
        pytest.skip("the field's files are not here")
    view, said = opened(path)
    assert "decoded" in said[0]
    sphere = SphereView(24)
    assert not (sphere.mask & ~view.mask).any()
    assert float((view.normals - sphere.normals)[:, sphere.mask[0]].abs().max()) < 0.01
