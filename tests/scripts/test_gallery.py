"""The gallery of a library (scripts/gallery.py)."""

import os
import re
from argparse import Namespace
from collections.abc import Sequence
from math import pi
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import gallery as script
import torchbrdf as tb
from showcase import neighbours, page, studio, tiles
from torchbrdf.brdf import METRIC_NAMES, cell_difference
from torchbrdf.experiments.tables import BEGIN, END

pytestmark = pytest.mark.filterwarnings("ignore:.*material class.*:UserWarning")

TILE = 16
SMALL = {"size": 12, "tile": TILE, "samples": 16, "noise": 1.0, "classes": 2, "seed": 0}


# The light


def test_the_studio_is_grey_but_for_a_window_at_the_left_of_the_ball_and_a_bulb_at_its_right():
    light = studio.studio(64)
    hue = light.mean_radiance / light.mean_radiance.mean()
    assert float((hue - 1).abs().max()) < 0.05
    left, right, behind = torch.nn.functional.normalize(
        torch.tensor([[-0.95, 0.55, 0.45], [0.62, 0.42, 0.76], [0.0, 0.0, -1.0]]), dim=1
    )
    assert float(light.radiance_at(left)[0]) > 10
    assert float(light.radiance_at(right)[0]) > 10 * float(light.radiance_at(left)[0])
    assert float(light.radiance_at(behind)[0]) < 1


# Who is near whom


def test_distances_are_those_of_compare(tiny_tables: dict[str, tb.MerlTable]):
    tables = [tiny_tables[name] for name in ("red", "gold-0.3", "steel-0.15")]
    valid = tables[1].valid.clone()
    valid[30:60] = False
    tables[1] = tb.MerlTable(tables[1].values, valid, "holes")
    library = tb.MaterialLibrary.from_tables(tables)
    found = neighbours.distances(library)
    assert neighbours.METRIC in METRIC_NAMES
    assert found.diagonal().abs().max() < 1e-6
    for i, j in ((0, 1), (1, 0), (2, 1), (2, 0)):
        reference, other = (library.table(library.names[k]) for k in (i, j))
        expected = cell_difference(other, reference, neighbours.METRIC)
        assert float(found[i, j]) == pytest.approx(expected, rel=1e-5)
    assert float((found - found.T).abs().max()) > 0.01  # relative to the reference


def test_the_nearest_come_first_and_never_oneself():
    far = torch.tensor([[0.0, 3.0, 1.0], [2.0, 0.0, 5.0], [1.0, 4.0, 0.0]])
    assert neighbours.nearest(far, 0, 5) == [(2, 1.0), (1, 3.0)]
    assert neighbours.nearest(far, 1, 1) == [(0, 2.0)]


# Pictures


def test_a_white_ball_is_white_up_to_a_smooth_rim():
    picture = tiles.ball(torch.where(tb.SphereView(2 * TILE).mask, 1.0, 0).expand(3, -1, -1), 1.0)
    assert picture.shape == (4, TILE, TILE)
    assert float(picture[3].mean()) == pytest.approx(pi / 4, rel=2e-3)
    assert float(picture[:3, picture[3] > 0].min()) == pytest.approx(1, abs=1e-6)
    assert float(picture[3, 0, 0]) == 0
    assert len(picture[3].unique()) > 5


def test_a_picture_keeps_its_sides_and_what_is_up(tmp_path: Path):
    red, blue = torch.zeros(4, 64, 64), torch.zeros(4, 64, 64)
    red[[0, 3]] = 1
    blue[[2, 3], :32] = 1
    pair = tiles.side_by_side([red, blue])
    tiles.write_picture(tmp_path / "pair.webp", pair)
    with Image.open(tmp_path / "pair.webp") as opened:
        pixels = np.asarray(opened.convert("RGBA")).astype(int)
    assert pixels.shape == (64, 136, 4)
    assert pixels[32, 32] == pytest.approx([255, 0, 0, 255], abs=12)
    assert pixels[10, 104] == pytest.approx([0, 0, 255, 255], abs=12)
    assert pixels[54, 104, 3] == pixels[32, 68, 3] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["pair.webp"]


def test_the_overview_shows_the_truth_of_every_tile(tmp_path: Path):
    names = [tmp_path / f"{i}.webp" for i in range(14)]
    for i, path in enumerate(names):
        truth, recovered = torch.ones(4, 32, 32), torch.zeros(4, 32, 32)
        truth[:3] = i / 14
        tiles.write_picture(path, tiles.side_by_side([truth, recovered]))
    tiles.write_overview(tmp_path / "all.webp", names)
    with Image.open(tmp_path / "all.webp") as opened:
        pixels = np.asarray(opened.convert("RGBA")).astype(int)
    step = 116 + 8
    assert pixels.shape == (2 * step - 8, 12 * step - 8, 4)
    for i in range(14):
        y, x = divmod(i, 12)
        assert pixels[y * step + 58, x * step + 58] == pytest.approx([round(255 * i / 14)] * 3 + [255], abs=6)
    assert pixels[step + 58, 2 * step + 58, 3] == 0


# The page


def a_row(material: str, index: int, error: float, left_out: Sequence[str] = (), exposure: float = 0.6) -> page.Row:
    near = (("brass", 0.12), ("cc_red", 0.34))
    return page.Row(material, index, tuple(left_out), near, 2 * error, 0.01, error, 1.25, exposure)


ROWS = [a_row("felt", 0, 0.02), a_row("own/cc_blue", 1, 0.2, ["cc_red"]), a_row("silk", 0, 0.04)]


def test_the_page_goes_by_class_and_the_worst_is_first():
    text = page.body(ROWS, ["dull"])
    pictures = re.findall(r"!\[(.*?)\]\(figures/gallery/(.*?)\.webp\)", text)
    assert [name for _, name in pictures] == ["overview", "silk", "felt", "own-cc_blue"]
    assert all(alternative for alternative, _ in pictures)
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        "## In figures", "## Class 0: dull", "## Class 1"
    ]  # fmt: skip
    assert "| all | 3 | 8.7 | 4.0 | 17 | 20 | 1.2 |" in text
    worst = text.split("### The worst 3")[1]
    assert worst.index("own/cc_blue") < worst.index("silk") < worst.index("felt")


def test_a_cell_tells_the_error_and_which_neighbours_were_left_out():
    lines = page._cell(ROWS[1], 0.6).replace("\u00a0", " ").replace("<wbr>", "").split("<br>")
    assert lines[1:] == ["**own/cc_blue**", "20 %, ΔE 1.2", "brass 12 %", "*cc_red* 34 %"]


def test_a_cell_names_an_exposure_that_is_not_the_usual_one():
    assert "ΔE\u00a01.2, exposure\u00a00.3<br>" in page._cell(a_row("pearl", 0, 0.1, exposure=0.3), 0.6)


def test_a_bright_ball_is_exposed_less_and_a_highlight_is_not():
    ball = torch.full((3, 100), 0.5)
    ball[:, :10] = 100
    assert script.exposure_for(ball) == script.EXPOSURE
    ball[0, :20] = 3.0
    ball[1:, :20] = 0
    assert script.exposure_for(ball) == script.EXPOSURE / 2


def test_every_line_of_a_table_has_as_many_cells():
    lines = [line for line in page.body(ROWS, []).splitlines() if line.startswith("| !")]
    assert [line.count("|") for line in lines] == [3, 3]


# The command


@pytest.fixture
def family_folder(merl_directory: Path, tmp_path: Path) -> Path:
    """Eight tables, two of which are of one family."""
    folder = tmp_path / "tables"
    folder.mkdir()
    for i, path in enumerate(sorted(merl_directory.iterdir())):
        os.link(path, folder / (f"cc_{i}.binary" if i < 2 else path.name))
    return folder


def test_a_material_is_recovered_without_its_family(family_folder: Path, tmp_path: Path):
    library = tb.MaterialLibrary.from_merl(family_folder, progress=False)
    gallery = script.Gallery.of(library, Namespace(**SMALL, output=tmp_path / "out"))
    weights, fitted = gallery.recovered(["cc_0", "cc_1"])
    assert weights.shape == (2, library.n, 3)
    columns = [3 * library.position(name) + c for name in ("cc_0", "cc_1") for c in range(3)]
    assert not weights[:, columns].any()
    assert weights.any()
    true, shown = gallery.shown_pair("cc_1", weights[1])
    expected = tb.render(library.table("cc_1"), studio.studio(), gallery.shown)
    assert float((true - expected).norm() / expected.norm()) < 0.1  # 16 samples a pixel
    row = gallery.row("cc_1", float(fitted[1]), true, shown)
    assert row.left_out == ("cc_0",)
    assert row.error == pytest.approx(float((shown - true).norm() / true.norm()), rel=1e-5)
    assert row.error > 0
    near = dict(row.neighbours)
    assert row.stranger >= min(near.values())
    assert "cc_1" not in near


def test_an_interrupted_command_goes_on_where_it_stopped(
    family_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    document = tmp_path / "docs" / "page.md"
    document.parent.mkdir()
    document.write_text(f"# Page\n\n{BEGIN}\nold\n{END}\n\nafter\n")
    stale = document.parent / "figures" / "gallery" / "gone.webp"
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"")
    small = [text for key, value in SMALL.items() for text in (f"--{key}", str(value))]
    command = ["--library", str(family_folder), "-o", str(tmp_path / "out"), "--document", str(document), *small]
    written: list[Path] = []
    write_row = script.write_row

    def interrupted(path: Path, row: page.Row) -> None:
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        write_row(path, row)

    monkeypatch.setattr(script, "write_row", interrupted)
    assert script.main(command) == 130
    assert "the same command goes on where it stopped" in capsys.readouterr().err
    assert "old" in document.read_text()
    assert stale.exists()
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "rows").iterdir()}
    assert len(before) == 3
    monkeypatch.setattr(script, "write_row", write_row)
    assert script.main(command) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    text = document.read_text()
    assert "old" not in text
    assert text.startswith("# Page")
    assert text.endswith("after\n")
    named = set(re.findall(r"figures/gallery/(\S+?\.webp)", text))
    assert named == {path.name for path in stale.parent.iterdir()}
    assert len(named) == 9
    monkeypatch.setattr(script.Gallery, "of", None)
    assert script.main(command) == 0
    assert document.read_text() == text
    assert script.main([*command, "--noise", "2"]) == 2
    assert "holds results with another noise (1.0, now 2.0)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--size", "4"], "--size and --tile must be at least 8, got 4 and 192"),
        (["--noise", "-1"], "--noise must be a percentage of at least 0, got -1.0"),
        (["--samples", "1"], "--samples must be at least 2, got 1"),
        (["--library", "nowhere"], "nowhere"),
        (["--document", "nowhere.md"], "nowhere.md: No such file"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert script.main(["-o", str(tmp_path / "out"), *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("gallery: error: ")
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
