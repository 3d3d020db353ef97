"""Figures 2 to 5 of the paper as sheets of pictures (scripts/paper_figures.py)."""

from collections.abc import Sequence
from importlib import import_module
from math import cos, pi, radians, sin
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

import torchbrdf as tb
from materials import lambert
from torchbrdf.images import write_image
from torchbrdf.images.display import tone_map
from torchbrdf.mitsuba_backend.scenes import HalfRenderings

pytest.importorskip("matplotlib", reason="the figures need matplotlib")

pytestmark = pytest.mark.filterwarnings("ignore:.*supports 1 material class", "ignore:.*material class.*:UserWarning")

PIECES = ("sheet", "studio", "light", "leave_one_out", "capture", "defects")

script, sheet, studio_module, light_module, loo, capture, defects = (
    import_module(name)
    for name in ("paper_figures", *(f"paper.figures.{name}" for name in PIECES))
)

TILE = 16


def lopsided(seed: int) -> tb.LightProbe:
    """Two lamps on a dim ground, elsewhere for every seed."""
    radiance = torch.full((3, 16, 32), 0.3)
    for row, column in torch.randint(2, 14, (2, 2), generator=torch.Generator().manual_seed(seed)).tolist():
        radiance[:, row : row + 2, 2 * column : 2 * column + 2] = 6.0
    return tb.LightProbe(radiance, name=f"light probe rooms/{'abc'[seed]}.exr")


@pytest.fixture
def studio(tiny_library: tb.MaterialLibrary, tmp_path: Path) -> "studio_module.Studio":
    return studio_module.Studio(tiny_library, studio_module.Quality(12, TILE, samples=64), tmp_path)


# Sheets


def test_a_white_ball_has_no_dark_rim() -> None:
    assert sheet.sphere_tile(torch.ones(3, 33, 33)).min() == pytest.approx(1, abs=1e-6)


def test_the_silhouette_is_as_large_as_the_disc() -> None:
    tile = sheet.sphere_tile(torch.zeros(3, TILE, TILE))
    assert float((1 - tile).mean()) == pytest.approx(pi / 4, rel=2e-3)
    assert 0 < float(tile[0, 0, TILE // 2 + 3]) < 1


def test_a_tile_keeps_what_is_up_and_applies_exposure_and_gamma() -> None:
    image = torch.zeros(3, TILE, TILE)
    image[0, : TILE // 2] = 0.25
    tile = sheet.sphere_tile(image, exposure=2.0)
    assert float(tile[0, 4, TILE // 2]) == pytest.approx(0.5 ** (1 / 2.2), abs=1e-6)
    assert float(tile[0, -4, TILE // 2]) == 0


def test_a_photograph_shrinks_by_means() -> None:
    image = torch.zeros(3, 32, 32)
    image[1, :16] = 1
    tile = sheet.photograph_tile(image, 8)
    assert tile.shape == (3, 8, 8)
    assert (float(tile[1, 0, 0]), float(tile[1, -1, 0]), float(tile[0].amax())) == (1, 0, 0)


def a_sheet(marked: bool = False) -> "sheet.Sheet":
    corner = torch.ones(3, 80, 80)
    corner[1:, :40, :20] = 0
    corner[:2, 40:, :20] = 0
    tiles = [sheet.Tile(corner, "specular-blue-phenolic", marked), sheet.Tile(corner, "12 % (112 %)"), None]
    rows = [sheet.Row("from a light probe of a long name,\ndefault", tiles)]
    rows.append(sheet.Row("", [sheet.Profile(torch.linspace(-1, 2, 80), torch.ones(80)), None, None]))
    columns = ["gold-metallic-paint2", "", "x"]
    return sheet.Sheet([sheet.Block("first", columns, rows), sheet.Block("", columns, rows)])


def test_no_label_leaves_the_sheet_or_touches_another() -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = a_sheet(marked=True).figure()
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in figure.texts if text.get_text()]
    assert len(boxes) == 2 * (1 + 2 + 2) + 1
    width, height = figure.get_size_inches() * figure.dpi
    for i, box in enumerate(boxes):
        assert min(box.x0, box.y0) >= 0
        assert box.x1 <= width
        assert box.y1 <= height
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_pictures_stand_pixel_for_pixel_in_the_file(tmp_path: Path) -> None:
    a_sheet().write(tmp_path / "sheet.png")
    pixels = tb.read_image(tmp_path / "sheet.png", allow_ldr=True)
    red = (pixels[0] > 0.99) & (pixels[1:] < 0.01).all(0)
    rows, columns = np.nonzero(red.numpy())
    assert int(red.sum()) == 4 * 40 * 20  # two blocks of two tiles, each with a red corner
    assert columns.max() - columns.min() == 80 + 8 + 19  # at the left of two tiles beside one another
    assert np.diff(np.unique(rows)).max() > 1 + 40  # at the top of tiles one below another
    blue = (pixels[2] > 0.99) & (pixels[:2] < 0.01).all(0)
    assert np.nonzero(blue.numpy())[0].min() == rows.min() + 40
    assert len(list(tmp_path.iterdir())) == 1
    a_sheet(marked=True).write(tmp_path / "marked.png")
    framed = tb.read_image(tmp_path / "marked.png", allow_ldr=True)
    changed = (framed - pixels).abs().amax(0) > 0.1
    assert 4 * 80 < int(changed.sum()) < 6 * 4 * 80 * 2 + 2000  # two frames and bold captions


def test_long_words_break_where_they_may() -> None:
    ruler = sheet._Ruler()
    assert ruler.broken("from grace,\npaper", 500) == "from grace,\npaper"
    broken = ruler.broken("specular-blue-phenolic", 100)
    assert broken.replace("\n", "") == "specular-blue-phenolic"
    assert ruler.width(broken) <= 100 < ruler.width("specular-blue-phenolic")


# The studio


def test_what_was_made_is_made_again_only_for_other_settings_or_damage(tmp_path: Path) -> None:
    made: list[int] = []

    def make() -> dict[str, torch.Tensor]:
        made.append(1)
        return {"count": torch.tensor(len(made))}

    path = tmp_path / "kept" / "count.safetensors"
    for settings, count in (({"a": 1}, 1), ({"a": 1}, 1), ({"a": 2}, 2)):
        assert int(studio_module.stored(path, settings, make)["count"]) == count
    path.write_bytes(path.read_bytes()[:20])
    assert int(studio_module.stored(path, {"a": 2}, make)["count"]) == 3


@pytest.mark.parametrize("angle", [0, 60, 136])
def test_a_directional_light_shows_the_table(studio: "studio_module.Studio", angle: int) -> None:
    weights = 0.3 * studio.itself("red") + 0.7 * studio.itself("copper-0.08")
    shown = studio.under([weights], light_module.Light(angle))[0]
    table = studio.library.combine(weights)
    torch.testing.assert_close(shown, tb.render_directional(table, studio.shown, angle, irradiance=pi))
    assert shown.sum() > 0
    half = studio.shown.size[1] // 2
    assert shown[..., half:].sum() >= shown[..., :half].sum() * (0.99 if angle == 0 else 1.5)


def test_negative_weights_stay_negative(studio: "studio_module.Studio") -> None:
    for source in (lopsided(0), 0):
        light = light_module.Light(source)
        positive, negative = studio.under([studio.itself("teal"), -studio.itself("teal")], light)
        torch.testing.assert_close(negative, -positive)
        assert positive.max() > 0


def test_pictures_under_a_probe_are_renderings(studio: "studio_module.Studio") -> None:
    shown = studio.under([studio.itself("plastic-0.2")], light_module.Light(lopsided(1)))[0]
    expected = tb.render(studio.library.table("plastic-0.2"), lopsided(1), studio.shown, seed=5)
    assert light_module.ball_error(shown, expected) < 0.1  # 64 samples a pixel


def test_weights_of_a_part_of_the_library_find_their_places(studio: "studio_module.Studio") -> None:
    names = studio.library.without("red").names
    weights = studio.weights(torch.ones(27, 3), names)
    position = 3 * studio.library.position("red")
    assert not weights[position : position + 3].any()
    assert int(weights.sum()) == 27 * 3


def test_noise_depends_on_its_key_and_has_its_size(studio: "studio_module.Studio") -> None:
    image = torch.full((3, 64, 64), 5.0)
    noisy = studio.noisy(image, "a", 2.0)
    assert float((noisy / 5 - 1).std()) == pytest.approx(0.02, rel=0.05)
    torch.testing.assert_close(noisy, studio.noisy(image, "a", 2.0), rtol=0, atol=0)
    assert not torch.equal(noisy, studio.noisy(image, "b", 2.0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"noise": -1.0}, "noise must be a percentage of at least 0, got -1.0"),
        ({"samples": 1}, "samples must be at least 2, got 1"),
    ],
)
def test_impossible_qualities_are_refused(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        studio_module.Quality(**arguments)


def test_lights_have_names_and_exposures() -> None:
    light = light_module.Light(lopsided(2))
    assert light.label(1.234) == "c, exposure 1.2"
    assert light_module.Light(tb.LightProbe.default(16)).name == "default"
    assert light_module.Light(136).label(1.0) == "light at 136°"
    bright = torch.full((3, 4, 4), 1.6)
    assert light.exposure([bright]) == pytest.approx(0.5)
    assert light_module.Light(0).exposure([bright]) == 1


def test_captions_say_the_error_and_that_of_the_display() -> None:
    reference = torch.full((3, TILE, TILE), 4.0)
    assert light_module.Light(lopsided(0)).caption(1.052 * reference, reference) == "5.2 %"
    assert light_module.Light(0).caption(1.5 * reference, reference) == "50 % (0.0 %)"
    assert [light_module.percent(share) for share in (0.0994, 0.0996, 1.124)] == ["9.9 %", "10 %", "112 %"]


# Figures 2, 3 and 5


def test_a_material_is_reconstructed_without_itself(studio: "studio_module.Studio") -> None:
    names = ["satin-0.35", "steel-0.15"]
    found = loo.fits(studio, names, "satin-0.35", lopsided(0), [studio_module.PAPER, studio_module.OURS])
    position = 3 * studio.library.position("satin-0.35")
    for fit in found:
        assert not fit.weights[position : position + 3].any()
        assert not fit.candidates[:, position : position + 3].any()
    photograph = studio.photographs(names, lopsided(0))["satin-0.35"]
    basis = studio.basis(lopsided(0), studio.photographed)
    for fit in found:
        residual = torch.einsum("nc,ncp->cp", fit.weights, basis.packed.double()) - basis.pack(photograph)
        assert float(residual.square().sum()) == pytest.approx(float(fit.error), rel=1e-3)


def drawn(
    figure: str, studio: "studio_module.Studio", names: Sequence[str]
) -> tuple["sheet.Sheet", list[list[str]]]:
    probes = [lopsided(seed) for seed in range(3)]
    found, numbers = getattr(loo, figure)(studio, probes, names)
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in numbers.split("\n")]
    return found, [lines[0], *lines[2:]]


def test_figure_2_has_a_block_a_light_and_a_column_a_material(studio: "studio_module.Studio") -> None:
    found, numbers = drawn("figure_2", studio, ["gold-0.3"])
    assert [block.title.split(",")[0] for block in found.blocks] == ["c", "light at 0°", "light at 136°"]
    labels = ["reference", *(f"from {probe},\n{how}" for probe in "ab" for how in ("paper", "default"))]
    for block in found.blocks:
        assert [row.label for row in block.rows] == labels
        assert [cell.caption for cell in block.rows[0].cells] == [""]
        assert all(cell.caption.endswith(("%", "%)")) for row in block.rows[1:] for cell in row.cells)
    assert [row[0] for row in numbers[1:]] == [label.replace("\n", " ") for label in labels[1:]]


def test_figure_3_marks_the_class_of_least_error_on_the_photograph(
    monkeypatch: pytest.MonkeyPatch, studio: "studio_module.Studio"
) -> None:
    fit = loo.Fit(torch.zeros(30, 3), torch.zeros(3, 30, 3), torch.tensor([2.0, 0.5, 0.7]), torch.tensor(0.25))
    fit.candidates[1] = studio.itself("white")
    monkeypatch.setattr(loo, "fits", lambda *_: [fit, fit, fit])
    found, numbers = drawn("figure_3", studio, ["white"])
    (block,) = found.blocks
    assert block.columns == ["reference", "class 0", "class 1", "class 2", "naive", "default"]
    for row in block.rows:
        assert [cell.marked for cell in row.cells] == [False, False, True, False, False, False]
    assert [cell.caption for cell in block.rows[0].cells[1:4]] == [
        "eq. 19: 2.00\n100 %", "eq. 19: 0.500\n0.0 %", "eq. 19: 0.700\n100 %"
    ]  # fmt: skip
    assert numbers[3] == ["white, class 1 (best)", "0.500", "0.0 %", "0.0 %"]
    photograph = studio.photographs(["white"], lopsided(2))["white"]
    noise = float((studio.basis(lopsided(2), studio.photographed).image("white") - photograph).square().sum())
    assert block.rows[0].cells[0].caption == f"eq. 19: {noise:#.3g}"
    assert 0 < noise < 0.01 * float(photograph.square().sum())


def test_figure_5_plots_the_middle_line_under_every_picture(studio: "studio_module.Studio") -> None:
    found, numbers = drawn("figure_5", studio, ["steel-0.15"])
    (block,) = found.blocks
    assert block.columns == ["b", "reference", "naive", "one class", "paper", "default"]
    assert [len(row.cells) for row in block.rows] == [6, 6, 6]
    reference = block.rows[2].cells[1]
    expected = studio.under([studio.itself("steel-0.15")], light_module.Light(0))[0][:, 7:9].mean((0, 1))
    torch.testing.assert_close(reference.radiance, expected)
    assert all(cell.reference is reference.reference for cell in block.rows[2].cells[1:])
    assert numbers[0] == ["a / light at 0°", "naive", "one class", "paper", "default"]


# Figure 4


def test_a_mask_leaves_the_ball_without_what_is_wrong() -> None:
    frame = capture.Frame(64)
    assert (frame.size, frame.circle.x, frame.circle.radius) == (80, 40, 32)
    whole = frame.cropped(capture.painted_mask(frame, capture.Defects()))
    assert float(whole.float().mean()) == pytest.approx(pi / 4, rel=0.01)
    dimple = whole & ~frame.cropped(capture.painted_mask(frame, capture.Defects(dimple=True)))
    rows, columns = np.nonzero(dimple[0].numpy())
    x, y = (columns.mean() + 0.5) / 32 - 1, 1 - (rows.mean() + 0.5) / 32
    assert (x, y) == (pytest.approx(0.41, abs=0.02), pytest.approx(0.27, abs=0.02))
    stand = whole & ~frame.cropped(capture.painted_mask(frame, capture.Defects(stand=True)))
    assert torch.equal(stand, stand.flip(-1))
    rows, _ = np.nonzero(stand[0].numpy())
    assert 32 < rows.min() < 55  # the reflection reaches higher than the stand itself, which is at row 59
    both = frame.cropped(capture.painted_mask(frame, capture.Defects(dimple=True, stand=True)))
    assert torch.equal(both, whole & ~dimple & ~stand)


@pytest.mark.parametrize(
    ("origin", "direction", "meets"),
    [
        ((0.0, -2.0, 2.0), (0.0, 0.0, -1.0), True),
        ((0.0, -0.5, 2.0), (0.0, 0.0, -1.0), False),
        ((0.6, -2.0, 2.0), (0.0, 0.0, -1.0), False),
        ((0.0, -2.0, 2.0), (0.0, 0.0, 1.0), False),
        ((0.0, -0.5, 0.0), (0.5, -1.0, 0.0), True),
        ((0.0, -0.8, 0.9), (0.0, -1.0, 0.0), False),
    ],
)
def test_rays_meet_the_stand_from_outside_and_inside(
    origin: Sequence[float], direction: Sequence[float], meets: bool
) -> None:
    vectors = [tuple(torch.tensor(value, dtype=torch.float64) for value in vector) for vector in (origin, direction)]
    assert bool(capture._meets_stand(*vectors)) == meets


def test_the_dimple_is_smooth_and_the_rest_a_sphere() -> None:
    ball = capture.dimpled_ball()
    radius = np.linalg.norm(ball.vertices, axis=1)
    middle = np.array([0.42, 0.28, 0.863])
    inside = ball.vertices @ (middle / np.linalg.norm(middle)) / radius > cos(0.16)
    np.testing.assert_allclose(radius[~inside], 1, atol=1e-6)
    assert radius.min() == pytest.approx(1 - 0.035, abs=1e-3)
    corners = ball.vertices[ball.faces].astype(float)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert (flat * ball.normals[ball.faces].mean(1)).sum(1).min() > cos(radians(5))  # and tilted by up to 19


def test_the_probe_of_a_user_is_turned_by_the_angle_asked_for() -> None:
    sound = lopsided(0)
    assert capture.recorded(sound, capture.Defects(stand=True)) is sound
    turned = capture.recorded(sound, capture.Defects(degrees=90.0))
    third = 1 / 3
    axis = torch.tensor([third, 2 * third, 2 * third])
    assert float(turned.radiance_at(axis)[0]) == pytest.approx(float(sound.radiance_at(axis)[0]), abs=0.05)
    assert not torch.allclose(turned.radiance, sound.radiance, atol=0.5)


GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}}


def test_a_grey_ball_in_a_white_room_is_grey_but_for_the_stand(mitsuba: ModuleType) -> None:
    white, frame = tb.LightProbe(torch.ones(3, 4, 8)), capture.Frame(TILE)
    quality = capture.TargetQuality(frame.size, 64, 0.02, 256)
    sphere = tb.SphereView(TILE)
    clean = capture.photograph_of(GREY, white, frame, capture.Defects(), quality)
    ball = sphere.pack(frame.cropped(clean))
    assert float(ball.mean()) == pytest.approx(0.5, rel=0.01)
    assert float((ball / 0.5 - 1).abs().max()) < 0.15  # Monte Carlo noise
    torch.testing.assert_close(clean[:, 0], torch.ones_like(clean[:, 0]))
    defects = capture.Defects(dimple=True, stand=True)
    spoilt = frame.cropped(capture.photograph_of(GREY, white, frame, defects, quality))
    assert float(spoilt[0, 3:8, 3:8].mean()) == pytest.approx(0.5, rel=0.03)
    assert float(spoilt[0, TILE - 2, 6:10].mean()) < 0.475  # shaded by the stand
    red, _, blue = spoilt[:, TILE - 1, 6:10].mean(1).tolist()  # the stand itself, of wood
    assert red < 0.38
    assert blue < 0.5 * red


@pytest.mark.parametrize("angle", [0, 60])
def test_mitsuba_and_torchbrdf_light_a_ball_from_the_same_side(mitsuba: ModuleType, angle: int) -> None:
    view = tb.SphereView(TILE)
    found = capture.lit_ball(GREY, view, angle, 256)
    table = tb.MerlTable.from_function(lambert(0.5, 0.5, 0.5))
    expected = tb.render_directional(table, view, angle, irradiance=pi)
    assert light_module.ball_error(found, expected) < 0.02
    brightest = view.pack(view.normals)[:, view.pack(found)[0].argmax()]
    assert float(brightest[0]) == pytest.approx(sin(radians(angle)), abs=0.15)


def test_what_a_mask_leaves_out_changes_nothing(studio: "studio_module.Studio") -> None:
    frame = capture.Frame(TILE)
    flaws = capture.Defects(dimple=True, stand=True)
    image = torch.zeros(3, frame.size, frame.size)
    image[:, frame.border : -frame.border, frame.border : -frame.border] = studio.under(
        [studio.itself("satin-0.35")], light_module.Light(lopsided(0))
    )[0]
    mask = capture.painted_mask(frame, flaws)
    spoilt = torch.where(mask, image, 9.0)
    clean, wrong = (defects.Capture(frame, one, mask, lopsided(0)) for one in (image, spoilt))
    for column in defects.COLUMNS:
        if column.setting.name == "robust":
            continue  # finds what is wrong by itself
        found = [column.weights(studio, one) for one in (clean, wrong)]
        assert torch.equal(*found) == column.masked


def test_a_column_may_tell_the_estimator_another_light(studio: "studio_module.Studio") -> None:
    frame = capture.Frame(TILE)
    (image,) = studio.under([studio.itself("satin-0.35")], light_module.Light(lopsided(0)))
    framed = torch.nn.functional.pad(image, [frame.border] * 4)
    mistaken = defects.Capture(frame, framed, capture.painted_mask(frame, capture.Defects()), lopsided(1))
    own = light_module.Light(lopsided(2))
    reference, *found = studio.under(
        [
            studio.itself("satin-0.35"),
            defects.Column("", studio_module.OURS, False).weights(studio, mistaken),
            defects.Column("", studio_module.OURS, False, probe=lambda *_: lopsided(0)).weights(studio, mistaken),
        ],
        own,
    )
    wrong, right = (light_module.ball_error(one, reference) for one in found)
    assert right < 0.05 < wrong


def test_figure_4_is_drawn_from_photographs_with_each_defect(
    studio: "studio_module.Studio", monkeypatch: pytest.MonkeyPatch
) -> None:
    rendered: list[capture.Defects] = []
    probes = [lopsided(seed) for seed in range(3)]
    grey = torch.full((3, TILE, TILE), 0.4)

    def photograph_of(bsdf, probe, frame, flaws, quality):
        rendered.append(flaws)
        assert (bsdf, probe) == (GREY, probes[0])
        return torch.full((3, frame.size, frame.size), 0.5)

    monkeypatch.setattr(defects, "photograph_of", photograph_of)
    monkeypatch.setattr(defects, "MitsubaScene", lambda view, probe, bsdf: None)
    monkeypatch.setattr(defects, "render_halves", lambda *_: (HalfRenderings(grey, grey), 2))
    monkeypatch.setattr(defects, "lit_ball", lambda *_: grey)
    found, numbers = defects.figure_4(studio, probes, [defects.Material("grey_rgb", GREY, "grey")])
    assert [(one.dimple, one.stand) for one in rendered] == [(False, False), (True, False), (False, True), (True, True)]
    (block,) = found.blocks
    assert block.title == "grey"
    assert block.columns == [
        "given", "reference", "naive,\nmasked", "paper,\nwhole ball", "paper,\nmasked", "default,\nwhole ball",
        "default,\nmasked",
    ]  # fmt: skip
    assert [row.label.split(",")[0] for row in block.rows] == ["a", "c", "light at 0°"]
    assert [row.cells[0] and row.cells[0].caption for row in block.rows] == ["photograph", "mask", None]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in numbers.split("\n")]
    assert [line[0] for line in lines[2:]] == list(defects.ONE_BY_ONE)
    assert all(cell.endswith(" %") for line in lines[2:] for cell in line[1:])


def test_defects_are_applied_to_the_photograph(
    studio: "studio_module.Studio", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(defects, "photograph_of", lambda *_: torch.full((3, 20, 20), 0.5))
    subject = defects.Subject(studio, defects.Material("grey_rgb", GREY, "grey"), lopsided(0), lopsided(1))
    brighter = subject.capture(capture.Defects(exposure=1.05))
    torch.testing.assert_close(brighter.photograph, torch.full((3, 20, 20), 0.525))
    assert brighter.probe is subject.captured
    spoilt = subject.capture(defects.ALL)
    assert float((spoilt.photograph / 0.525 - 1).std()) == pytest.approx(0.02, rel=0.1)
    assert spoilt.probe.fingerprint == lopsided(0).rotated(capture.tilt(1.0)).fingerprint


# The command


@pytest.fixture
def inputs(merl_directory: Path, tmp_path: Path) -> list[str]:
    tb.MaterialLibrary.from_merl(merl_directory, progress=False)
    names = []
    for seed in range(3):
        names.append(str(tmp_path / f"{'abc'[seed]}.exr"))
        write_image(names[-1], lopsided(seed).radiance)
    small = ["--size", "12", "--tile", "16", "--samples", "16"]
    return ["--library", str(merl_directory), "--probes", *names, "-o", str(tmp_path / "out"), *small]


def test_an_interrupted_command_goes_on_where_it_stopped(
    inputs: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["5", *inputs, "--materials", "satin-0.5"]
    photographs, out = studio_module.Studio.photographs, tmp_path / "out"
    calls: list[str] = []

    def counted(self, materials, probe):
        calls.append(probe.name)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return photographs(self, materials, probe)

    monkeypatch.setattr(studio_module.Studio, "photographs", counted)
    assert script.main(command) == 130
    assert "interrupted; the same command goes on where it stopped" in capsys.readouterr().err
    assert not (out / "paper_figure_5.png").exists()
    assert len(list((out / "kept").glob("fits-*"))) == 1
    monkeypatch.setattr(studio_module.Studio, "photographs", photographs)
    assert script.main(command) == 0
    assert (out / "paper_figure_5.md").read_text() in capsys.readouterr().out
    assert tb.read_image(out / "paper_figure_5.png", allow_ldr=True).shape[1] > 6 * 16
    files = {path: path.read_bytes() for path in out.glob("paper_figure_*")}
    monkeypatch.setattr(studio_module, "render_tables", None)
    monkeypatch.setattr(tb.BRDFEstimator, "forward", None)
    assert script.main(command) == 0
    assert {path: path.read_bytes() for path in out.glob("paper_figure_*")} == files


def test_bad_input_is_one_line(
    inputs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "measured").mkdir()
    (tmp_path / "measured" / "felt.bsdf").write_text("")
    a = inputs[3]
    cases = [
        (["2", *inputs], "no material 'pink-felt' in this library of 8"),
        (["2", *inputs, "--probes", a, a, "default"], "probes must have different names; 'a' comes twice"),
        (["2", *inputs, "--probes", a, "default"], "--probes: give three, A B C, got 2"),
        (["2", *inputs, "--probes", a, "default", "none.exr"], "none.exr: no such file"),
        (["2", *inputs, "--library", str(tmp_path / "empty")], "empty"),
        (["3", *inputs, "--noise", "-1"], "noise must be a percentage of at least 0, got -1.0"),
        (["3", *inputs, "--samples", "1"], "samples must be at least 2, got 1"),
        (["3", *inputs, "--materials", "teal", "--tile", "2"], "a sphere needs an image of at least 3 x 3 pixels"),
        (["4", *inputs], "figure 4 needs measured materials: give --measured with a folder of .bsdf files"),
        (["4", *inputs, "--measured", str(tmp_path / "empty")], "no .bsdf files here; give a folder of measured"),
        (
            ["4", *inputs, "--measured", str(tmp_path / "measured"), "--captured", "silk"],
            f"--captured: no silk.bsdf in {tmp_path / 'measured'}; there are felt",
        ),
    ]
    for command, message in cases:
        capsys.readouterr()
        assert script.main(command) == 2
        error = capsys.readouterr().err
        assert error.startswith("paper_figures: error: ")
        assert message in error
        assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
    with pytest.raises(SystemExit):
        script.main(["6", *inputs])
    assert "invalid choice: 6 (choose from 2, 3, 4, 5)" in capsys.readouterr().err


def test_tone_mapping_is_the_papers() -> None:
    shown = sheet.sphere_tile(torch.full((3, TILE, TILE), 0.5))
    assert float(shown[0, 8, 8]) == pytest.approx(float(tone_map(torch.tensor(0.5))), abs=1e-6)
