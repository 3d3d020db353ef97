"""What `--view` names: a sphere, meshes, normal maps, and one line for all else."""

import argparse

import pytest
import torch

from torchbrdf.commands._inputs import open_view
from torchbrdf.images import write_image
from torchbrdf.view import NormalMapView, SphereView


def options(view, **given):
    names = ("fov", "toward", "up", "target", "width")
    return argparse.Namespace(**{"view": str(view), **dict.fromkeys(names), "no_shadows": False, **given})


def test_an_encoded_normal_map_is_decoded(tmp_path):
    sphere, path = SphereView(24), tmp_path / "n.exr"
    write_image(path, torch.where(sphere.mask, sphere.normals / 2 + 0.5, 0.5))
    with pytest.warns(UserWarning, match=r"n\.exr: its numbers are n/2 \+ 1/2 and were decoded"):
        view = open_view(options(path), 24)
    assert isinstance(view, NormalMapView)
    torch.testing.assert_close(view.normals, sphere.normals)


def test_a_picture_in_place_of_normals_is_one_line_with_its_name(tmp_path):
    path = tmp_path / "photo.exr"
    write_image(path, torch.rand(3, 24, 24, generator=torch.Generator().manual_seed(0)) * 5)
    with pytest.raises(ValueError, match=r"^[^\n]*photo\.exr: its numbers are no known normals[^\n]*; expected unit"):
        open_view(options(path), 24)


@pytest.mark.parametrize("name", ["shape.stl", "shape.fbx", "shape", "sphre"])
@pytest.mark.parametrize("given", [{}, {"fov": 30.0}, {"no_shadows": True}])
def test_other_files_are_refused_with_all_that_is_possible(name, given):
    with pytest.raises(ValueError, match=rf"^{name}: --view takes sphere, a mesh .*\.ply.*\.glb.* normal map .*\.exr"):
        open_view(options(name, **given), 24)
