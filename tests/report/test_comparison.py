"""`torchbrdf compare`: what its page holds, bad tables, and the light turned in a real browser."""

import base64
import math
import re
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import torch

from materials import glossy, lambert
from pages import Page, pixels
from torchbrdf.brdf.difference import delta_e_2000
from torchbrdf.brdf.merl import MerlTable, cell_centres
from torchbrdf.cli import main
from torchbrdf.commands._inputs import labels
from torchbrdf.images.display import tone_map
from torchbrdf.images.primaries import converted
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.directional import render_directional
from torchbrdf.rendering.tables import render_tables
from torchbrdf.report._turned_spheres import COMPARE_STYLE, LIGHT
from torchbrdf.report.comparison import Comparison
from torchbrdf.report.comparison_page import write_comparison
from torchbrdf.report.page import source_hash
from torchbrdf.view.sphere import SphereView

SIZE = 48
NAMES = ("paint", "gold <b>&", "mirror")
SMALL = ["--size", "24", "--samples", "32"]


def compared(tables, names=None, samples=64):
    return Comparison.of(tables, LightProbe.default(32), names, size=SIZE, samples=samples)


@pytest.fixture(scope="module")
def tables():
    """Paint that varies with phi_d, without mirror symmetry; metal; and a lobe a fifth of a degree wide, with a peak
    near what half floats hold."""
    paint = MerlTable.from_function(glossy((0.4, 0.05, 0.02), (0.05, 0.04, 0.05), 0.2), "plastic")
    paint = replace(paint, values=paint.values * (1 + 0.25 * torch.sin(2 * cell_centres()[2]))[:, None])
    mirror = MerlTable.from_function(glossy((0.0, 0.0, 0.0), (0.9, 0.9, 0.9), 0.003), "mirror")
    assert float(mirror.values.max()) > 1e4
    return [paint, MerlTable.from_function(glossy((0.01, 0.01, 0.005), (0.9, 0.7, 0.3), 0.3), "gold"), mirror]


@pytest.fixture(scope="module")
def comparison(tables):
    return compared(tables, NAMES)


@pytest.fixture(scope="module")
def path(comparison, tmp_path_factory):
    path = tmp_path_factory.mktemp("compare") / "page.html"
    write_comparison(path, comparison)
    return path


@pytest.fixture(scope="module")
def text(path):
    return path.read_text(encoding="utf-8")


def test_the_page_is_self_contained_and_well_formed(text):
    page = Page(re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL))
    bare = re.sub(r"base64,[^\"]*|<script type=\"text/plain\"[^>]*>[^<]*", "", text)
    assert not re.search(r"https?:|//\w|@import|url\(|<link|<iframe|innerHTML|eval\(|fetch\(|XMLHttp", bare)
    assert all(set(attrs).isdisjoint({"href", "srcset", "onload", "style"}) for _, attrs in page.tags)
    assert all(attrs["src"].startswith("data:image/png;base64,") and attrs["alt"].strip() for attrs in page.all("img"))
    assert all(attrs.get("aria-label") or attrs.get("aria-hidden") for attrs in page.all("svg"))
    assert [attrs["aria-label"] for attrs in page.all("canvas")] == list(NAMES)
    names = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(set(names)) == len(names)
    assert set(re.findall(r'find\("([\w-]+)"\)', text)) <= set(names)
    sections = ["Under a light probe", "Under a light that you turn", "Image slices", "In the plane of incidence"]
    words = " ".join(page.text)
    assert [title for title in sections if title in words] == sections
    assert "<b>&" not in text.replace("gold &lt;b&gt;&amp;", "")
    kinds = [attrs.get("class") for attrs in page.all("svg")]
    assert kinds.count("polar") == 4 * len(NAMES)
    assert sum(attrs.get("class") == "slice" for attrs in page.all("div")) == 2 * len(NAMES)


def test_the_policy_allows_its_own_script_and_style_only(text):
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    (script,) = re.findall(r"<script>(.*?)</script>", text, flags=re.DOTALL)
    (style,) = re.findall(r"<style>(.*?)</style>", text, flags=re.DOTALL)
    assert policy.startswith(f"default-src 'none'; script-src {source_hash(script)}; style-src {source_hash(style)};")
    assert "unsafe" not in policy
    assert style == COMPARE_STYLE


def test_the_numbers_are_those_of_the_pictures(comparison, tables, text):
    view = SphereView(SIZE)
    images = render_tables(tables, LightProbe.default(32), view, 64)
    assert torch.equal(images, comparison.pictures)
    inside = view.mask.expand(3, -1, -1)
    for image, difference in zip(images[1:], comparison.differences, strict=True):
        expected = (image - images[0])[inside].double().norm() / images[0][inside].double().norm()
        assert difference.picture == pytest.approx(float(expected), rel=1e-6)
        for share in (*difference.cells.values(), difference.picture):
            assert f"<td>{share:.2%}</td>" in text
        assert f"<td>{difference.delta_e_mean:.2f}</td><td>{difference.delta_e_95:.2f}</td>" in text
    page = Page(re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))
    shown = pixels(next(attrs for attrs in page.all("img") if attrs["alt"] == "sphere: gold <b>&"))
    expected = tone_map(images[1], comparison.exposure).movedim(0, -1).numpy()
    assert np.abs(shown - expected)[view.mask[0].numpy()].max() < 0.6 / 255


def test_other_primaries_are_shown_in_those_of_a_screen(tables):
    light, view = LightProbe.default(32), SphereView(SIZE)
    wide = [replace(t, values=converted(t.values.T, "rec709", "rec2020").T) for t in tables[:2]]
    found = Comparison.of(wide, light, size=SIZE, samples=64, primaries="rec2020")
    expected = [converted(image, "rec2020", "rec709") for image in render_tables(wide, light, view, 64)]
    torch.testing.assert_close(found.pictures, torch.stack(expected))
    colours = delta_e_2000(expected[1], expected[0], found.exposure)[view.mask[0]]
    assert found.differences[0].delta_e_mean == pytest.approx(float(colours.mean()))
    torch.testing.assert_close(found.probe.radiance, converted(light.radiance, "rec2020", "rec709").clamp_min(0))
    for shown, table in zip(found.shown, tables, strict=False):  # in white light a table has its own colours in both
        assert (shown.values - table.values)[table.valid].abs().max() < 1e-5 * table.values.max()
    (here,) = compared(wide).differences
    assert found.differences[0].cells == here.cells
    assert found.differences[0].delta_e_mean > 1.05 * here.delta_e_mean  # taken for a screen's they look paler


def test_a_name_that_is_no_text_is_escaped(comparison, tmp_path):
    write_comparison(tmp_path / "page.html", comparison, "r\udce9.binary")
    assert "r\\udce9.binary" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_tables_that_gradients_are_wanted_of(tables, tmp_path):
    learned = MerlTable(tables[0].values.clone().requires_grad_(), tables[0].valid, "learned")
    write_comparison(tmp_path / "page.html", compared([learned, tables[1]]))
    assert "learned" in (tmp_path / "page.html").read_text()


def test_where_the_default_type_is_float64(tables, tmp_path):
    torch.set_default_dtype(torch.float64)
    try:
        comparison = Comparison.of(tables, LightProbe.default(16), size=8, samples=8)
        write_comparison(tmp_path / "page.html", comparison)
    finally:
        torch.set_default_dtype(torch.float32)
    assert "</html>" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_the_albedo_of_equal_tables_that_do_not_differ():
    white = MerlTable.from_function(lambert(0.8, 0.8, 0.74), "white")
    found = compared([white, white])
    assert found.albedo[1].tolist() == pytest.approx([0.78] * 4, rel=2e-3)
    assert found.warnings == []
    (difference,) = found.differences
    assert [*difference.cells.values(), difference.picture] == [0] * 4
    assert [difference.delta_e_mean, difference.delta_e_95] == pytest.approx([0, 0], abs=1e-12)


def test_the_command(tables, tmp_path, capsys):
    folder = tmp_path / "fitted"
    folder.mkdir()
    tables[0].save(tmp_path / "paint.binary")
    tables[1].save(folder / "brdf.binary")
    out = tmp_path / "page.html"
    assert main(["compare", str(tmp_path / "paint.binary"), str(folder), *SMALL, "-o", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert re.fullmatch(
        r"fitted from paint: l2 [\d.]+%, log [\d.]+%, cube-root [\d.]+%; picture [\d.]+%, delta E mean [\d.]+, "
        r"95 % below [\d.]+",
        lines[0],
    )
    assert lines[1:] == [f"wrote {out}"]
    assert "<h1>paint and fitted</h1>" in out.read_text(encoding="utf-8")


def test_labels(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    one, two = tmp_path / "one" / "x.binary", tmp_path / "two" / "x.binary"
    assert labels([one, tmp_path / "two"]) == ["x", "two"]
    assert labels([one, two]) == [str(one), str(two)]
    assert labels([one, one, two]) == [f"{one} (1)", f"{one} (2)", str(two)]


def refused(capsys, tmp_path, *arguments):
    out = tmp_path / "page.html"
    assert main(["compare", *map(str, arguments), *SMALL, "-o", str(out)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1, captured.err
    assert not list(tmp_path.glob("*.html")), "a page was written"
    assert not list(tmp_path.glob(".page*")), "a temporary file was left"
    return captured.err.removeprefix("torchbrdf: error: ").rstrip()


def test_bad_input_is_one_line(tables, tmp_path, capsys):
    good, black = tmp_path / "good.binary", tmp_path / "black.binary"
    tables[0].save(good)
    replace(tables[0], values=0 * tables[0].values).save(black)
    message = f"compare needs two BRDFs or more, got {good} alone; name the reference first"
    assert refused(capsys, tmp_path, good) == message
    missing = tmp_path / "missing.binary"
    assert refused(capsys, tmp_path, good, missing) == f"{missing}: no such file; expected a MERL .binary table"
    message = f"{tmp_path}: no brdf.binary in this folder; name a MERL table or a folder of `torchbrdf fit`"
    assert refused(capsys, tmp_path, good, tmp_path) == message
    message = "black: nothing differs relatively from a BRDF of 0; name another table first"
    assert refused(capsys, tmp_path, black, good) == message
    short = tmp_path / "short.binary"
    short.write_bytes(good.read_bytes()[:1000])
    assert "truncated MERL table: expected 34992012 bytes, got 1000" in refused(capsys, tmp_path, good, short)


def test_a_table_without_a_measured_cell_is_one_line(tables, tmp_path, capsys):
    good, bad = tmp_path / "good.binary", tmp_path / "bad.binary"
    tables[0].save(good)
    stored = np.fromfile(good, "<f8", offset=12)
    bad.write_bytes(good.read_bytes()[:12] + (-1 - abs(stored)).tobytes())
    message = f"{bad}: the table has no measured cell: all are negative or below the horizon; the file is damaged"
    assert refused(capsys, tmp_path, good, bad).startswith(message)


def test_another_name_than_html(tables, tmp_path, capsys):
    tables[0].save(tmp_path / "a.binary")
    table, out = str(tmp_path / "a.binary"), tmp_path / "x.png"
    assert main(["compare", table, table, "-o", str(out)]) == 2
    assert capsys.readouterr().err == f"torchbrdf: error: {out}: the comparison is a page; name it X.html\n"
    assert not out.exists()


def test_what_a_reader_should_know_stands_first(tables, tmp_path, capsys):
    good = tables[0]
    valid = good.valid.clone()
    valid[:, :40] = False
    holes = MerlTable(torch.where(valid[..., None], good.values, -1.0), valid, "holes")
    black = replace(good, values=0 * good.values, name="black")
    bright = replace(good, values=20 * good.values, name="bright")
    for table in (good, holes, black, bright):
        table.save(tmp_path / f"{table.name}.binary")
    paths = [str(tmp_path / f"{table.name}.binary") for table in (good, holes, black, bright)]
    out = tmp_path / "page.html"
    assert main(["compare", *paths, *SMALL, "-o", str(out)]) == 0
    printed, said = capsys.readouterr()
    text = out.read_text(encoding="utf-8")
    assert "nan" not in re.sub(r"base64,[^\"]*|<script.*?</script>", "", text, flags=re.DOTALL).lower()
    share = float((~valid & good.valid).sum() / good.valid.sum())
    warned = [
        f"holes: {share:.1%} of its cells above the horizon were not measured; the pictures show their nearest "
        "measured neighbours there.",
        "black: 0 in every measured cell.",
        f"holes and plastic: {1 - share:.1%} of the cells were measured in both; the differences over cells count no "
        "others.",
    ]
    for warning in warned:
        assert f"torchbrdf: warning: {warning}\n" in said
        assert f"<li>{warning}</li>" in text
    assert re.search(r"warning: bright: reflects [\d.]+ times the light that comes in at \d+°\.", said)
    assert "warning: plastic: " not in said
    assert "holes from plastic: l2 0.00%, log 0.00%, cube-root 0.00%; picture " in printed
    assert "black from plastic: l2 100.00%, log 100.00%, cube-root 100.00%; picture 100.00%" in printed
    assert "bright from plastic: l2 1900.00%" in printed


def test_tables_without_a_common_cell(tables):
    half = torch.zeros_like(tables[0].valid)
    half[:40] = True
    parts = {"a": half, "b": ~half}
    one, other = (replace(tables[0], valid=tables[0].valid & part, name=name) for name, part in parts.items())
    with pytest.raises(ValueError, match="b: no cell was measured both here and in a: nothing can be compared"):
        compared([one, other])
    with pytest.raises(ValueError, match="a comparison needs two tables or more, each with a name, got 1"):
        compared([one])


@pytest.fixture
def tab(browser, path):
    tab = opened(browser, path)
    assert not tab.is_visible("#problem"), tab.inner_text("#problem")
    return tab


def opened(browser, path, script=None, width=1064):
    tab = browser.new_context(offline=True, viewport={"width": width, "height": 900}).new_page()
    tab.complaints, tab.requests = [], []
    tab.on("console", lambda message: tab.complaints.append(message.text))
    tab.on("pageerror", lambda error: tab.complaints.append(str(error)))
    tab.on("request", lambda request: tab.requests.append(request.url.split(":")[0]))
    if script is not None:
        tab.add_init_script(script)
    tab.goto(path.as_uri())
    tab.locator("#turn").scroll_into_view_if_needed()
    return tab


PIXELS = """index => {
  const canvas = document.querySelectorAll("canvas")[index];
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return btoa(String.fromCharCode(...data));
}"""


def picture(tab, index):
    """(N, N, 3): display values of a sphere."""
    data = base64.b64decode(tab.evaluate(PIXELS, index))
    return np.frombuffer(data, np.uint8).reshape(SIZE, SIZE, 4)[..., :3] / 255.0


@contextmanager
def redrawn(tab):
    """Waits until the page has drawn what the block asks for.

    Nothing that draws may go without it: its picture would pass for that of the next block.
    """
    before = frames(tab)
    yield
    tab.wait_for_function("before => Number(document.getElementById('frames').value) > before", arg=before)


def frames(tab):
    return int(tab.inner_text("#frames"))


def assert_agrees(tab, tables, direction, gain):
    """What the browser drew is `render_directional` of the whole tables, at 4 x 4 points a pixel as well.

    The error that is allowed is that of 12 layers in phi_d, half floats and 8 bits.
    """
    view = SphereView(SIZE)
    inside = view.mask[0].numpy()
    for i, table in enumerate(tables):
        image = render_directional(table, view, direction=torch.tensor(direction), irradiance=math.pi)
        expected = tone_map(image, gain).movedim(0, -1).numpy()[inside]
        found = picture(tab, i)[inside]
        assert expected.max() > 0.3
        assert np.abs(found - expected).mean() < 0.5 / 255
        assert np.quantile(np.abs(found - expected), 0.99) < 2 / 255


def start_gain(tab):
    return float(tab.get_attribute("#turn", "data-gain"))


def test_the_browser_draws_what_we_render(tab, tables):
    assert_agrees(tab, tables, LIGHT, start_gain(tab))
    stills = tab.locator("#turn img")
    assert [stills.nth(i).is_visible() for i in range(3)] == [False] * 3
    assert set(tab.requests) <= {"file", "data"}
    assert [text for text in tab.complaints if "GPU stall due to ReadPixels" not in text] == []


def test_the_highlight_goes_where_the_pointer_is(tab, tables):
    box = tab.locator("canvas").nth(1).bounding_box()
    x, y = -0.5, 0.3
    with redrawn(tab):
        tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        tab.mouse.down()
    assert tab.inner_text("#angle") == "0°"
    assert_agrees(tab, tables, (0.0, 0.0, 1.0), start_gain(tab))
    with redrawn(tab):
        tab.mouse.move(box["x"] + box["width"] * (1 + x) / 2, box["y"] + box["height"] * (1 - y) / 2)
        tab.mouse.up()
    z = math.sqrt(1 - x * x - y * y)
    direction = (2 * z * x, 2 * z * y, 2 * z * z - 1)
    assert_agrees(tab, tables, direction, start_gain(tab))
    shown = picture(tab, 1).sum(-1)
    rows, columns = np.nonzero(shown >= np.quantile(shown, 0.99))
    assert (columns.mean() / SIZE * 2 - 1, 1 - rows.mean() / SIZE * 2) == pytest.approx((x, y), abs=0.12)
    assert tab.inner_text("#angle") == f"{round(math.degrees(math.acos(direction[2])))}°"
    assert tab.inner_text("#around") == f"{round(math.degrees(math.atan2(x, y)) % 360)}°"
    before = frames(tab)
    tab.mouse.move(box["x"], box["y"])
    assert frames(tab) == before, "the light turns though no button is pressed"


def test_light_from_behind(tab, tables):
    box = tab.locator("canvas").nth(0).bounding_box()
    with redrawn(tab):
        tab.mouse.click(box["x"] + 0.97 * box["width"], box["y"] + box["height"] / 2)
    x = 0.94
    z = math.sqrt(1 - x * x)
    assert_agrees(tab, tables[:2], (2 * z * x, 0.0, 2 * z * z - 1), start_gain(tab))
    with redrawn(tab):
        tab.mouse.down()
    with redrawn(tab):
        tab.mouse.move(box["x"] + box["width"] + 30, box["y"] - 40)  # beyond the rim
        tab.mouse.up()
    assert int(tab.inner_text("#angle")[:-1]) > 170


def test_keys_exposure_and_reset(tab, tables):
    start, gain = picture(tab, 0), start_gain(tab)
    tab.locator("canvas").nth(0).focus()
    light = np.array(LIGHT)
    step = math.pi / 36
    c, s = math.cos(step), math.sin(step)
    about = {"x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])}
    about["z"] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turns = {"ArrowRight": about["y"], "ArrowDown": about["x"], "ArrowUp": about["x"].T, "Shift+ArrowLeft": about["z"]}
    for key in ("ArrowRight", "ArrowRight", "ArrowDown", "ArrowUp", "ArrowUp", "Shift+ArrowLeft"):
        with redrawn(tab):
            tab.keyboard.press(key)
        light = turns[key] @ light
    assert_agrees(tab, tables, light.tolist(), gain)
    with redrawn(tab):
        tab.fill("#stops", "-2")
    assert tab.inner_text("#exposure") == "−2.00 stops"
    assert_agrees(tab, tables[:1], light.tolist(), gain / 4)
    with redrawn(tab):
        tab.fill("#stops", "0")
    for act in (lambda: tab.click("#reset"), lambda: tab.locator("canvas").nth(2).press("Home")):
        with redrawn(tab):
            tab.locator("canvas").nth(2).press("ArrowUp")
        with redrawn(tab):
            act()
        assert (picture(tab, 0) == start).all()


def test_the_difference_from_the_first(tab, tables):
    start, gain = picture(tab, 0), start_gain(tab)
    with redrawn(tab):
        tab.check("#difference")
    assert tab.is_visible("#scale")
    assert (picture(tab, 0) == start).all()
    view = SphereView(SIZE)
    images = [
        render_directional(table, view, direction=torch.tensor(LIGHT), irradiance=math.pi) for table in tables[:2]
    ]
    more = torch.einsum("chw,c->hw", images[1] - images[0], torch.tensor([0.2126, 0.7152, 0.0722])) * gain
    shown = picture(tab, 1)
    inside = view.mask[0].numpy()
    red, blue = shown[..., 0] - shown[..., 2] > 0.1, shown[..., 2] - shown[..., 0] > 0.1
    assert red[inside & (more > 0.1).numpy()].all()
    assert blue[inside & (more < -0.1).numpy()].all()
    assert (red & inside).any()
    near = inside & (more.abs() < 0.002).numpy()
    assert near.any()
    assert np.abs(shown[near] - 0.97).max() < 0.02


BLIND = """
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind === "webgl2" ? null : context.call(this, kind, ...more);
};
"""


def test_without_webgl_the_rest_of_the_page_is_there(browser, path):
    tab = opened(browser, path, BLIND)
    assert tab.inner_text("#problem") == (
        "The light cannot be turned here: this browser has no WebGL 2. The spheres below are lit as the text says."
    )
    assert [tab.locator("#turn img").nth(i).is_visible() for i in range(3)] == [True] * 3
    assert [tab.locator("canvas").nth(i).is_visible() for i in range(3)] == [False] * 3
    assert not tab.is_visible("#controls")
    assert tab.complaints == []


def test_a_lost_graphics_processor_comes_back(browser, path):
    tab = opened(
        browser,
        path,
        BLIND.replace("return kind", "const made = context.call(this, kind, ...more);\n  "
        'if (kind === "webgl2") window.lose = made.getExtension("WEBGL_lose_context");\n  return made; kind'),
    )  # fmt: skip
    start = picture(tab, 1)
    tab.evaluate("lose.loseContext()")
    tab.wait_for_selector("#problem", state="visible")
    assert tab.inner_text("#problem").startswith("The browser took the graphics processor away from this page")
    tab.locator("canvas").nth(1).press("ArrowUp")
    with redrawn(tab):
        tab.evaluate("lose.restoreContext()")
        tab.wait_for_selector("#problem", state="hidden")
    with redrawn(tab):
        tab.locator("canvas").nth(1).press("Home")
    assert (picture(tab, 1) == start).all()


@pytest.mark.parametrize("width", [640, 1064])
def test_nothing_scrolls_sideways(browser, path, width):
    tab = opened(browser, path, width=width)
    assert not tab.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth")
    widths = tab.evaluate("Array.from(document.images, image => image.complete ? image.naturalWidth : 0)")
    assert min(widths) > 0
