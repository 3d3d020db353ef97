from importlib import import_module
from math import cos, radians, sin
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
import trimesh

import torchbrdf as tb
from torchbrdf.experiments import meshes
from torchbrdf.rendering.tables import render_tables

pytestmark = pytest.mark.filterwarnings("ignore:.*supports 1 material class")


@pytest.fixture
def scenes(mitsuba: ModuleType) -> ModuleType:
    return import_module("known_shapes_scenes")


@pytest.fixture
def report(mitsuba: ModuleType) -> ModuleType:
    return import_module("known_shapes_report")


@pytest.fixture
def cost(mitsuba: ModuleType) -> ModuleType:
    return import_module("known_shapes_cost")


@pytest.fixture(scope="module")
def light() -> tb.LightProbe:
    """A bright half of the sky: most of the light comes from image right."""
    radiance = torch.full((3, 16, 32), 0.2)
    radiance[:, :, 16:24] = 4.0
    return tb.LightProbe(radiance)


@pytest.mark.parametrize("opening", [20, 90, 180])
def test_a_cap_has_the_area_of_a_spherical_cap(scenes: ModuleType, opening: float) -> None:
    cap = meshes.cap(opening)
    mesh = trimesh.Trimesh(cap.vertices, cap.faces, process=False)
    assert mesh.area == pytest.approx(2 * np.pi * (1 - cos(radians(opening))), rel=2e-3)
    assert (mesh.area_faces > 0).all()
    outward = (mesh.face_normals * mesh.triangles_center).sum(1)
    assert (outward > 0).all()


def test_a_cap_shows_the_normals_of_its_opening(scenes: ModuleType) -> None:
    view = meshes.mesh_view(meshes.cap(40), tb.Camera(width=2 * sin(radians(40))), 24)
    steepest = view.pack(view.normals)[2].min()
    assert cos(radians(40)) - 1e-3 <= steepest < cos(radians(36))


def test_the_half_sphere_shows_its_right_half(scenes: ModuleType) -> None:
    view = meshes.mesh_view(meshes.half_sphere_from_the_side(), tb.Camera(target=(0.0, 0.0, 0.0), width=2.0), 24)
    normals = view.pack(view.normals)
    assert normals[0].min() > 0
    assert (normals[1].min() < -0.8, normals[1].max() > 0.8) == (True, True)


def test_the_side_of_the_cylinder_is_smooth_and_its_ends_are_flat(scenes: ModuleType) -> None:
    mesh = meshes.cylinder()
    upright = np.abs(mesh.normals[:, 1])
    assert set(np.unique(upright.round(5))) == {0.0, 1.0}
    side = upright < 0.5
    np.testing.assert_allclose(mesh.normals[side], mesh.vertices[side] * [1, 0, 1], atol=1e-5)


def test_planes_and_cubes_show_fewer_normals_than_a_ball_of_flat_faces(scenes: ModuleType) -> None:
    shapes = meshes.few_normals()
    names = ("plane", "cube", "icosahedron", "ball of 80 faces", "sphere")
    coverage = [meshes.mesh_view(*shapes[name], 32).normal_coverage for name in names]
    assert coverage == sorted(coverage)
    assert coverage[2] < 0.15 < coverage[3]


def test_what_a_shape_reflects_onto_itself_comes_without_the_noise_of_direct_light(
    scenes: ModuleType, cost: ModuleType, tiny_library: tb.MaterialLibrary, light: tb.LightProbe, tmp_path: Path
) -> None:
    judge = scenes.Judge(tiny_library, ["white", "red"], {}, 8)
    ball = meshes.mesh_view(meshes.cap(180), meshes.FRONT, 8)
    assert cost.interreflections(judge, light, ball)[0].abs().max() == 0
    meshes.faceted(_corner(), "corner").save(tmp_path / "corner.ply")
    view = tb.MeshView(tmp_path / "corner.ply", 12, tb.Camera(toward=(0.0, 0.3, 1.0)))
    reflected, single = cost.interreflections(judge, light, view)
    assert reflected.min() >= 0
    white, red = reflected.sum((0, 2, 3, 4)).tolist()
    assert white > 2 * red > 0
    direct = render_tables(judge.tables, light, view, samples=512)
    torch.testing.assert_close(single.mean(0).sum(), direct.sum(), rtol=0.02, atol=0)


def _corner() -> trimesh.Trimesh:
    """Two walls at a right angle, open towards the camera."""
    walls = [trimesh.creation.box((2.0, 2.0, 0.02)) for _ in range(2)]
    for wall, turn in zip(walls, (np.pi / 4, -np.pi / 4), strict=True):
        wall.apply_transform(trimesh.transformations.rotation_matrix(turn, [0, 1, 0]))
        wall.apply_translation([np.copysign(np.sqrt(0.5), -turn), 0, 0])
    return trimesh.util.concatenate(walls)


def test_a_photograph_of_a_ball_of_known_material_is_judged_by_novel_light(
    scenes: ModuleType, tiny_library: tb.MaterialLibrary, light: tb.LightProbe
) -> None:
    novel = tb.LightProbe(light.radiance.roll(16, -1))
    names = tiny_library.names[:2]
    judge = scenes.Judge(tiny_library, names, {"novel": novel}, 8)
    judge.classes = {name: tb.MaterialClasses.single(tiny_library.without(name)) for name in names}
    basis = tb.render_basis(tiny_library, light, judge.view)
    results = judge.fit(basis, torch.stack([basis.image(name) for name in names]), noise=0)
    found = judge.judge(results)
    assert found["white"].observation < 0.05  # of seven materials 52 pixels are explained so well
    table = results["white"].brdf(tiny_library.without("white"))
    whole = judge.table_errors([table], ["white"])
    assert float(whole[0]) == pytest.approx(found["white"].novel, abs=0.02)


def test_noise_has_the_standard_deviation_asked_for(scenes: ModuleType) -> None:
    clean = torch.full((3, 64, 64), 5.0)
    photograph = scenes.noisy(clean, 2.0, seed=1)
    assert float((photograph / clean - 1).std()) == pytest.approx(0.02, rel=0.05)
    torch.testing.assert_close(scenes.noisy(clean, 2.0, seed=1), photograph)


def test_monte_carlo_noise_is_that_of_the_mean_of_two_halves(scenes: ModuleType) -> None:
    halves = 1 + 0.1 * torch.randn(2, 1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    noise = scenes.Photographs(halves).noise
    assert float(noise[0]) == pytest.approx(0.1 / 2**0.5, rel=0.03)


def test_tiles_have_no_light_lines_where_one_part_hides_another(report: ModuleType) -> None:
    n = report.display_size()
    mask = torch.zeros(1, n, n, dtype=torch.bool)
    mask[:, 90:300, 90:300] = True
    mask[:, :, 180] = False
    image = torch.where(mask, torch.full((3, n, n), 0.2), 0.0)
    tile = report.on_white(image, mask)
    inside = tile[:, 32:98, 32:98]
    assert inside.max() == inside.min() == pytest.approx(0.2 ** (1 / 2.2), abs=1e-5)
    assert tile[:, :20].min() == 1


def test_tables_are_markdown_with_means(
    scenes: ModuleType, report: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    judgements = {"ball": {"a": scenes.Judgement(0.01, 0.02), "b": scenes.Judgement(0.03, 0.06)}}
    report.print_judgements(("a", "b"), judgements)
    assert capsys.readouterr().out.splitlines() == [
        "| shape | a | b | mean |",
        "|---|---:|---:|---:|",
        "| ball | 1.00 / 2.00 | 3.00 / 6.00 | 2.00 / 4.00 |",
    ]


def test_the_pictures_are_written(report: ModuleType, tmp_path: Path) -> None:
    tile = torch.rand(3, 150, 150)
    report.write_grid(tmp_path / "grid.png", ("a", "b"), {"red": {"observed": [tile, None], "recovered": [tile, tile]}})
    report.write_scatter(tmp_path / "scatter.png", {"ball": 1.0}, {"ball": 2.0}, 0.15)
    assert (tmp_path / "grid.png").stat().st_size > 10_000
    assert (tmp_path / "scatter.png").stat().st_size > 5_000
