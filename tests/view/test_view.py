from math import radians, sin, tan

import pytest
import torch
from torch import Tensor

from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView


def sub_pixel(view, n: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Random points of every pixel: u, v (P, n), normals and view directions (3, P, n), and their image
    coordinates are left to the test.
    """
    g = torch.Generator().manual_seed(seed)
    u, v = torch.rand(2, len(view.pixels), n, generator=g)
    points = view.surface(view.pixels, u, v)
    return view.pixels, u, v, points.normals, points.view_dirs


def image_plane(pixels: Tensor, u: Tensor, v: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """x to the right and y upwards in [-1, 1] of points inside pixels."""
    row, column = (pixels // size)[:, None], (pixels % size)[:, None]
    return (column + u) / size * 2 - 1, 1 - (row + v) / size * 2


VIEWS = [SphereView(3), SphereView(16), SphereView(17), SphereView(24, fov_deg=40), SphereView(9, fov_deg=120)]


@pytest.mark.parametrize("view", VIEWS, ids=repr)
class TestEverySphere:
    def test_shapes(self, view: SphereView):
        height, width = view.size
        assert height == width
        assert view.mask.shape == (1, height, width)
        assert view.mask.dtype == torch.bool
        assert view.normals.shape == view.view_dirs.shape == (3, height, width)
        assert len(view.pixels) == int(view.mask.sum())

    def test_normals_and_view_directions_are_unit_and_face_each_other(self, view: SphereView):
        *_, normals, view_dirs = sub_pixel(view, 8)
        assert torch.allclose(normals.norm(dim=0), torch.ones(()), atol=1e-5)
        assert torch.allclose(view_dirs.norm(dim=0), torch.ones(()), atol=1e-5)
        assert float((normals * view_dirs).sum(0).min()) > -1e-4
        inside = view.mask.expand(3, -1, -1)
        assert torch.allclose(view.normals.norm(dim=0)[view.mask[0]], torch.ones(()), atol=1e-5)
        assert float(view.normals[~inside].abs().sum()) == 0

    def test_the_top_is_plus_y_the_right_is_plus_x_the_camera_is_on_plus_z(self, view: SphereView):
        n, mask = view.normals, view.mask[0]
        size = len(mask)
        middle = size // 2
        rows, columns = torch.nonzero(mask.any(1)).ravel(), torch.nonzero(mask.any(0)).ravel()
        if size > 3:
            assert float(n[1, rows[0], middle]) > 0.15
            assert float(n[1, rows[-1], middle]) < -0.15
            assert float(n[0, middle, columns[-1]]) > 0.15
            assert float(n[0, middle, columns[0]]) < -0.15
        assert float(n[2, middle, middle]) > 0.8
        assert torch.allclose(view.normals.flip(2)[1:], view.normals[1:], atol=1e-5)
        assert torch.allclose(view.normals.flip(1)[[0, 2]], view.normals[[0, 2]], atol=1e-5)

    def test_the_mask_holds_the_pixels_inside_the_silhouette_and_no_others(self, view: SphereView):
        """By the farthest corner, pixel by pixel: the silhouette is the unit circle of the image."""
        (size, _), mask = view.size, view.mask[0]
        for row in range(size):
            for column in range(size):
                corners = [(2 * x / size - 1, 2 * y / size - 1) for x in (column, column + 1) for y in (row, row + 1)]
                farthest = max(x * x + y * y for x, y in corners)
                if abs(farthest - 1) > 1e-12:
                    assert bool(mask[row, column]) == (farthest < 1)

    def test_pack_and_unpack(self, view: SphereView):
        height, width = view.size
        image = torch.rand(2, 3, height, width)
        packed = view.pack(image)
        assert packed.shape == (2, 3, len(view.pixels))
        assert torch.equal(packed, image[:, :, view.mask[0]])
        assert torch.equal(view.unpack(packed), torch.where(view.mask, image, 0))


def test_orthographic_normals_are_the_image_coordinates():
    view = SphereView(20)
    pixels, u, v, normals, view_dirs = sub_pixel(view, 16)
    x, y = image_plane(pixels, u, v, 20)
    assert torch.allclose(normals, torch.stack([x, y, (1 - x * x - y * y).sqrt()]), atol=1e-5)
    assert torch.equal(view_dirs, torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand_as(view_dirs))


@pytest.mark.parametrize("fov", [5.0, 60.0, 150.0])
def test_perspective_rays_meet_the_surface_at_its_normal(fov: float):
    """The normal of a unit sphere is the point itself: it must project back to where it came from, the camera
    stands where the sphere fills the field of view, and the view direction points from the surface to it.
    """
    view = SphereView(20, fov_deg=fov)
    pixels, u, v, normals, view_dirs = sub_pixel(view, 16)
    x, y = image_plane(pixels, u, v, 20)
    half = radians(fov) / 2
    distance = 1 / sin(half)
    depth = distance - normals[2]
    assert torch.allclose(normals[0] / depth / tan(half), x, atol=2e-4)
    assert torch.allclose(normals[1] / depth / tan(half), y, atol=2e-4)
    to_camera = torch.tensor([0.0, 0.0, distance])[:, None, None] - normals
    assert torch.allclose(view_dirs, to_camera / to_camera.norm(dim=0), atol=2e-4)
    assert float((normals * to_camera).sum(0).min()) > -1e-3, "the far side of the sphere is seen"


def test_perspective_tends_to_orthographic():
    centre = SphereView(32).normals
    gaps = [float((SphereView(32, fov_deg=fov).normals - centre).abs().max()) for fov in (40.0, 20.0, 10.0, 5.0)]
    assert gaps[0] > 2 * gaps[3] > 0
    assert gaps == sorted(gaps, reverse=True)
    assert float((SphereView(32, fov_deg=1.0).normals - centre).abs().max()) < 0.02
    assert torch.equal(SphereView(32, fov_deg=1.0).mask, SphereView(32).mask)


@pytest.mark.parametrize("size", [2, 1, 0, -4])
def test_too_small(size: int):
    with pytest.raises(ValueError, match=f"at least 3 x 3 pixels, got size={size}"):
        SphereView(size)


@pytest.mark.parametrize("fov", [0.0, -10.0, 180.0, float("nan")])
def test_impossible_field_of_view(fov: float):
    with pytest.raises(ValueError, match="fov_deg must lie between 0 and 180 degrees, got"):
        SphereView(8, fov_deg=fov)


def test_fingerprints_tell_views_apart():
    sphere = SphereView(8)
    bumped = sphere.normals.clone()
    bumped[:, 4, 4] = torch.tensor([0.0, 0.6, 0.8])
    tilted = torch.tensor([0.0, 0.1, 1.0])[:, None, None].expand(3, 8, 8)
    fewer = sphere.mask.clone()
    fewer[0, 4, 4] = False
    views = [
        sphere,
        SphereView(9),
        SphereView(8, fov_deg=30),
        SphereView(8, fov_deg=31),
        NormalMapView(sphere.normals, sphere.mask),
        NormalMapView(bumped, sphere.mask),
        NormalMapView(sphere.normals, fewer),
        NormalMapView(sphere.normals, sphere.mask, tilted),
    ]
    assert len({view.fingerprint for view in views}) == len(views)
    assert SphereView(8, fov_deg=30).fingerprint == views[2].fingerprint
    assert NormalMapView(sphere.normals, sphere.mask).fingerprint == views[4].fingerprint


class TestNormalMap:
    def test_a_sphere_given_by_its_normals_is_the_sphere(self):
        """Inside a pixel the normal map only has slopes: near the silhouette they are coarse."""
        sphere = SphereView(64)
        view = NormalMapView(sphere.normals, sphere.mask)
        assert torch.equal(view.mask, sphere.mask)
        assert torch.equal(view.pixels, sphere.pixels)
        assert torch.allclose(view.normals, sphere.normals, atol=1e-6)
        assert torch.allclose(view.view_dirs[:, view.mask[0]], sphere.view_dirs[:, view.mask[0]])
        g = torch.Generator().manual_seed(0)
        u, v = torch.rand(2, len(view.pixels), 16, generator=g)
        exact, found = sphere.surface(view.pixels, u, v).normals, view.surface(view.pixels, u, v).normals
        gap = (exact - found).norm(dim=0)
        across_pixel = (exact - sphere.pack(sphere.normals)[:, :, None]).norm(dim=0)
        facing = sphere.pack(sphere.normals)[2] > 0.5
        assert float(gap[facing].mean()) < 0.03 * float(across_pixel[facing].mean())
        assert float(gap[facing].max()) < 0.004
        assert float(gap.mean()) < 0.25 * float(across_pixel.mean())

    def test_perspective_view_directions_are_kept(self):
        sphere = SphereView(32, fov_deg=50)
        view = NormalMapView(sphere.normals, sphere.mask, sphere.view_dirs)
        assert torch.allclose(view.view_dirs, sphere.view_dirs, atol=1e-6)

    def test_a_plane_has_one_normal_everywhere_in_the_pixel(self):
        normal = torch.tensor([0.6, 0.0, 0.8])
        view = NormalMapView(normal[:, None, None].expand(3, 5, 7).contiguous())
        assert view.size == (5, 7)
        *_, normals, view_dirs = sub_pixel(view, 9)
        assert torch.allclose(normals, normal[:, None, None].expand_as(normals), atol=1e-6)
        assert float((view_dirs[2] - 1).abs().max()) == 0

    def test_a_crease_stays_sharp(self):
        """Two planes that meet at 90 degrees: no pixel sees a normal in between."""
        normals = torch.zeros(3, 6, 6)
        normals[0, :, :3], normals[0, :, 3:], normals[2] = -1.0, 1.0, 1.0
        view = NormalMapView(normals)
        *_, found, _ = sub_pixel(view, 9)
        assert float((found[0].abs() - 0.5**0.5).abs().max()) < 1e-6

    @pytest.mark.parametrize("used", [4, 6])
    @pytest.mark.parametrize("turned", [False, True])
    def test_slopes_do_not_reach_outside_the_mask_or_across_the_border(self, used: int, turned: bool):
        """A cylinder of six columns (or rows); beyond those used is garbage, and the last is no neighbour of the
        first.
        """
        angle = torch.linspace(-0.5, 0.5, 6)
        normals = torch.stack([angle.sin(), torch.zeros(6), angle.cos()])[:, None].repeat(1, 6, 1)
        normals[:, :, used:] = torch.tensor([0.0, 0.9, 0.5])[:, None, None]
        mask = (torch.arange(6) < used).expand(1, 6, 6).clone()
        if turned:
            normals, mask = normals.transpose(1, 2).contiguous(), mask.transpose(1, 2).contiguous()
        pixels, u, v, found, _ = sub_pixel(NormalMapView(normals, mask), 9)
        along, step = (pixels // 6, v) if turned else (pixels % 6, u)
        exact = angle[along][:, None] + (step - 0.5) * 0.2
        assert float(found[1].abs().max()) == 0
        assert torch.allclose(torch.atan2(found[0], found[2]), exact, atol=2e-3)

    def test_normals_are_normalised(self):
        sphere = SphereView(12)
        view = NormalMapView(sphere.normals * 7.0, sphere.mask)
        assert torch.allclose(view.normals, sphere.normals, atol=1e-6)

    def test_without_a_mask_all_pixels_with_a_normal_are_used(self):
        sphere = SphereView(12)
        assert torch.equal(NormalMapView(sphere.normals).mask, sphere.mask)
        normals = sphere.normals.clone()
        normals[:, ~sphere.mask[0]] = float("nan")
        assert torch.equal(NormalMapView(normals).mask, sphere.mask)

    def test_normals_that_face_away_leave_the_mask(self):
        normals = torch.tensor([0.0, 0.0, 1.0])[:, None, None].repeat(1, 4, 4)
        normals[:, 1, 2] = torch.tensor([0.0, 0.8, -0.6])
        view = NormalMapView(normals)
        assert not view.mask[0, 1, 2]
        assert int(view.mask.sum()) == 15

    def test_nan_normals_outside_the_mask_do_no_harm(self):
        sphere = SphereView(12)
        normals = sphere.normals.clone()
        normals[:, ~sphere.mask[0]] = float("nan")
        *_, found, _ = sub_pixel(NormalMapView(normals, sphere.mask), 4)
        *_, clean, _ = sub_pixel(NormalMapView(sphere.normals, sphere.mask), 4)
        assert torch.equal(found, clean)

    def test_unsound_normals_under_the_mask(self):
        normals = SphereView(8).normals.clone()
        normals[:, 4, 4] = float("nan")
        with pytest.raises(ValueError, match="normals are zero or not finite in 33 pixels of the mask"):
            NormalMapView(normals, torch.ones(1, 8, 8, dtype=torch.bool))

    def test_unsound_view_directions_under_the_mask(self):
        sphere = SphereView(8)
        dirs = torch.tensor([0.0, 0.0, 1.0])[:, None, None].repeat(1, 8, 8)
        dirs[:, 4, 4] = float("nan")
        with pytest.raises(ValueError, match=r"view_dirs.* 1 pixel"):
            NormalMapView(sphere.normals, sphere.mask, dirs)

    @pytest.mark.parametrize(
        ("normals", "mask", "dirs", "message"),
        [
            (torch.ones(1, 8, 8), None, None, r"normals must be \(3, H, W\), got \(1, 8, 8\)"),
            (torch.ones(8, 8, 3), None, None, r"normals must be \(3, H, W\), got \(8, 8, 3\)"),
            (torch.ones(3, 8, 8), torch.ones(1, 8, 8), None, r"mask must be bool \(1, 8, 8\), got torch.float32"),
            (
                torch.ones(3, 8, 8),
                torch.ones(1, 9, 8).bool(),
                None,
                r"mask must be bool \(1, 8, 8\), got .*\(1, 9, 8\)",
            ),
            (
                torch.ones(3, 8, 8),
                None,
                torch.ones(3, 1, 1),
                r"view_dirs must be \(3, 8, 8\) like normals, got \(3, 1, 1\)",
            ),
            (torch.ones(3, 8, 8), torch.zeros(1, 8, 8).bool(), None, "no pixel under the mask"),
            (-torch.ones(3, 8, 8), None, None, "no pixel under the mask has a normal that faces the camera"),
        ],
    )
    def test_bad_arguments(self, normals: Tensor, mask: Tensor, dirs: Tensor, message: str):
        with pytest.raises(ValueError, match=message):
            NormalMapView(normals, mask, dirs)


def test_first_asked_for_in_inference_mode() -> None:
    """What a view keeps enters graphs later."""
    for view in (SphereView(6), NormalMapView(SphereView(6).normals)):
        with torch.inference_mode():
            _ = view.pixels, view.normals, view.view_dirs
        for kept in (view.normals, view.view_dirs):
            values = torch.ones(3, 6, 6, requires_grad=True)
            assert torch.equal(torch.autograd.grad((kept * values).sum(), values)[0], kept)
        values = torch.ones(36, requires_grad=True)
        assert float(torch.autograd.grad(values[view.pixels].sum(), values)[0].sum()) == len(view.pixels)
