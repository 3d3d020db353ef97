"""`torchbrdf live`: its server's answers, and a real drag in a browser. The spheres are cheap stand-ins."""

import http.client
import math
import re
import signal
import threading
import time
from html.parser import HTMLParser
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from torchbrdf.cli import main
from torchbrdf.commands import live
from torchbrdf.images import write_image
from torchbrdf.light.probe import LightProbe
from torchbrdf.live._page import content_security_policy, page
from torchbrdf.live.server import LiveServer, listen, rotation_matrix
from torchbrdf.rendering.tables import render
from torchbrdf.report.style import LIVE_STYLE
from torchbrdf.view.sphere import SphereView

SIZE = 48
LABELS = ("result", "class 0 <b>", "class 1 (likeliest)")
LAMP = torch.nn.functional.normalize(torch.tensor([-0.5, 0.7, 0.8]), dim=0)


class Spheres:
    """Lambert and a highlight of growing width under one lamp."""

    labels = LABELS
    colours = torch.tensor([[0.75, 0.5, 0.15], [0.2, 0.4, 0.7], [0.5, 0.5, 0.5]])
    exponents = (120.0, 30.0, 400.0)

    def __init__(self, size=SIZE):
        view = SphereView(size)
        self.mask, self.normals = view.mask, view.normals
        self.mirrored = 2 * self.normals[2] * self.normals - torch.tensor([0.0, 0.0, 1.0])[:, None, None]
        self.rotations, self.threads, self.most_threads = [], 0, 0

    def render(self, rotation):
        self.rotations.append(rotation)
        self.threads += 1
        self.most_threads = max(self.most_threads, self.threads)
        lamp = rotation @ LAMP
        time.sleep(0.002)
        matte = torch.einsum("c,chw->hw", lamp, self.normals).clamp_min(0)
        mirrored = torch.einsum("c,chw->hw", lamp, self.mirrored).clamp_min(0)
        images = [colour[:, None, None] * matte for colour in self.colours]
        images = [image + 4 * mirrored**power for image, power in zip(images, self.exponents, strict=True)]
        self.threads -= 1
        return torch.stack(images) * self.mask

    def mirror_ball(self, rotation):
        towards = torch.einsum("cd,chw->dhw", rotation, self.mirrored)
        room = 0.3 + 0.2 * torch.stack([towards[0], towards[1], -towards[0]])
        checks = ((6 * towards).floor().sum(0) % 2)[None]
        lamp = 50 * (torch.einsum("c,chw->hw", LAMP, towards) > 0.98)
        return (room * (0.6 + 0.4 * checks) + lamp).clamp_min(0) * self.mask


@pytest.fixture
def spheres():
    return Spheres()


@pytest.fixture
def server(spheres):
    with LiveServer(spheres, listen(), "brass & co", "room <1>") as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def ask(server, path, method="GET", **headers):
    connection = http.client.HTTPConnection(*server.server_address, timeout=20)
    connection.putrequest(method, path, skip_host=True)
    for name, value in ({"Host": f"127.0.0.1:{server.server_address[1]}"} | headers).items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


def test_the_page(server):
    answer, body = ask(server, "/")
    assert answer.status == 200
    text = body.decode()
    parser = Elements(text)
    assert not re.search(r"https?:|//\w|@import|url\(|<iframe|<img|srcdoc", text)
    assert "innerHTML" not in text
    assert [attrs["href"] for tag, attrs in parser.tags if tag == "link"] == ["data:,"]
    assert all(set(attrs).isdisjoint({"src", "style", "onload", "action"}) for _, attrs in parser.tags)
    canvases = [attrs for tag, attrs in parser.tags if tag == "canvas"]
    assert [attrs["aria-label"] for attrs in canvases] == ["result", "the light", *LABELS[1:]]
    assert [attrs["data-picture"] for attrs in canvases] == ["0", "3", "1", "2"]
    assert all(attrs["tabindex"] == "0" and attrs["width"] == str(SIZE) for attrs in canvases)
    assert "<title>brass &amp; co" in text
    assert "Under room &lt;1&gt;." in text
    assert "class 0 <b>" not in text
    names = {attrs["id"] for _, attrs in parser.tags if "id" in attrs}
    assert names >= set(re.findall(r'find\("(\w+)"\)', text))


class Elements(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))


def test_the_policy_allows_the_page_its_own_script_and_style_only(server):
    answer, _ = ask(server, "/")
    policy = answer.headers["Content-Security-Policy"]
    assert policy == content_security_policy()
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe" not in policy
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "Python" not in answer.headers["Server"]
    assert LIVE_STYLE in page("a", "b", LABELS, 8)


def test_a_result_of_one_picture_has_no_section_of_candidates():
    assert "candidate" in page("a", "b", LABELS, 8).split("</style>")[1].split("<script>")[0]
    assert "candidate" not in page("a", "b", LABELS[:1], 8).split("</style>")[1].split("<script>")[0]


def frame(server, query):
    answer, body = ask(server, f"/frame?{query}")
    assert answer.status == 200, body
    assert answer.headers["Content-Length"] == str(len(body))
    return np.frombuffer(body, np.uint8).reshape(-1, SIZE, SIZE, 4).astype(int)


def test_a_frame_is_the_pictures_at_one_exposure_and_the_mirror_ball(server, spheres):
    shown = frame(server, "rotation=1,0,0,0")
    assert shown.shape == (4, SIZE, SIZE, 4)
    assert (shown[..., 3] == 255).all()
    images = spheres.render(torch.eye(3))
    inside = spheres.mask[0].numpy()
    white = float(torch.quantile(images[0].amax(0)[spheres.mask[0]].double(), 0.99))
    for got, image in zip(shown, images, strict=False):
        expected = 255 * (image.movedim(0, -1).numpy() / white).clip(0, 1) ** (1 / 2.2)
        assert np.abs(got[..., :3] - expected)[inside].max() < 0.51
        assert (got[0, SIZE // 2] == got[1, SIZE // 2]).all(), "the rim does not continue the sphere"
    mirrored = spheres.mirror_ball(torch.eye(3))
    white = float(torch.quantile(mirrored.amax(0)[spheres.mask[0]], 0.93))
    expected = 255 * (mirrored.movedim(0, -1).numpy() / white).clip(0, 1) ** (1 / 2.2)
    assert np.abs(shown[3][..., :3] - expected)[inside].max() < 0.51

    darker = frame(server, "rotation=1,0,0,0&stops=-2")
    dim = inside[..., None] & (shown[..., :3] < 255)
    assert np.abs(darker[..., :3] / 255 - shown[..., :3] / 255 * 4 ** (-1 / 2.2))[dim].max() < 1 / 255
    assert (frame(server, "rotation=0.8,0,0.6,0") != shown).any()


def test_dark_spheres_have_a_finite_exposure():
    dark = Spheres()
    dark.colours, dark.mirrored = 0 * dark.colours, 0 * dark.mirrored
    dark.mirror_ball = lambda rotation: torch.zeros(3, SIZE, SIZE)
    with LiveServer(dark, listen(), "dark", "night") as server:
        shown = np.frombuffer(server.frame(torch.eye(3), 20.0), np.uint8).reshape(-1, 4)
    assert (shown[:, :3] == 0).all()


@pytest.mark.parametrize("angle", [0.0, 0.3, -2.0, math.pi])
def test_a_quaternion_is_its_rotation(angle):
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    cos, sin = math.cos(angle), math.sin(angle)
    about = {
        (s, 0, 0): [[1, 0, 0], [0, cos, -sin], [0, sin, cos]],
        (0, s, 0): [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]],
        (0, 0, s): [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]],
    }
    for (x, y, z), expected in about.items():
        found = rotation_matrix(f"{1.0005 * c},{1.0005 * x},{1.0005 * y},{1.0005 * z}")
        assert torch.allclose(found, torch.tensor(expected, dtype=torch.float32), atol=1e-6)


BAD = ["", "1", "1,0,0", "1,0,0,0,0", "0,0,0,0", "2,0,0,0", "nan,0,0,0", "inf,0,0,0", "1,0,0,x", "1e999,1,1,1"]


@pytest.mark.parametrize("text", [*BAD, "1%0A0", "x" * 500])
def test_a_bad_rotation_is_one_line(server, spheres, text):
    rendered = len(spheres.rotations)
    answer, body = ask(server, f"/frame?rotation={text}")
    assert answer.status == 400
    assert body.startswith(b"rotation must be a unit quaternion w,x,y,z, got ")
    assert body.count(b"\n") == 1
    assert len(body) < 200
    assert len(spheres.rotations) == rendered


@pytest.mark.parametrize("query", ["stops=x", "stops=nan", "stops=21", "stops=-1e9", "stops="])
def test_a_bad_exposure_is_one_line(server, query):
    answer, body = ask(server, f"/frame?rotation=1,0,0,0&{query}")
    assert answer.status == 400
    assert body.startswith(b"stops must be a number from -20 to 20, got ")


PATHS = ["/index.html", "/frames", "/../../etc/passwd", "/frame/", "/favicon.ico", "http://127.0.0.1/", "*", "/%2e%2e/"]


@pytest.mark.parametrize("path", PATHS)
def test_nothing_else_is_served(server, path):
    answer, body = ask(server, path)
    assert answer.status == 404
    assert body == b"there is nothing here; the page is at /\n"


@pytest.mark.parametrize("method", ["POST", "PUT", "OPTIONS"])
def test_no_other_method(server, method):
    assert ask(server, "/", method)[0].status == 501


def test_a_head_has_no_body(server):
    answer, body = ask(server, "/", "HEAD")
    assert (answer.status, body) == (200, b"")
    assert int(answer.headers["Content-Length"]) == len(server.page)


FOREIGN = [None, "", "example.org", "127.0.0.1.example.org:80", "localhost.example.org", "[::1]", "0.0.0.0"]


@pytest.mark.parametrize("host", FOREIGN)
def test_foreign_hosts_are_turned_away(server, spheres, host):
    rendered = len(spheres.rotations)
    for path in ("/", "/frame?rotation=1,0,0,0"):
        answer, body = ask(server, path, Host=host)
        assert answer.status == 403
        assert body.decode() == f"this page is served as {server.url} only\n"
    assert len(spheres.rotations) == rendered


@pytest.mark.parametrize("host", ["localhost", "LocalHost:9000", "127.0.0.1"])
def test_a_tunnel_may_have_another_port(server, host):
    assert ask(server, "/", Host=host)[0].status == 200


def test_only_the_loopback_address_listens(server):
    assert server.socket.getsockname()[0] == "127.0.0.1"


def test_frames_are_rendered_one_at_a_time(server, spheres):
    threads = [threading.Thread(target=frame, args=(server, "rotation=1,0,0,0")) for _ in range(8)]
    before = len(spheres.rotations)
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(spheres.rotations) == before + 8
    assert spheres.most_threads == 1


def test_a_closed_server_renders_no_more(spheres):
    with LiveServer(spheres, listen(), "brass", "room") as server:
        server.frame(torch.eye(3), 0.0)
    with pytest.raises(ConnectionAbortedError):
        server.frame(torch.eye(3), 0.0)


def test_a_port_in_use_is_one_line(capsys, monkeypatch):
    pretend(monkeypatch)
    with listen() as taken:
        number = taken.getsockname()[1]
        assert main(["live", "--port", str(number), "--no-browser"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    advice = "give another port, or 0 for any that is free"
    start = rf"torchbrdf: error: cannot listen on 127\.0\.0\.1, port {number}: "
    assert re.fullmatch(rf"{start}[^\n]*; {advice}\n", captured.err)


def pretend(monkeypatch, spheres=None):
    """`torchbrdf live` without a fit; returns what it makes its spheres of, which are these."""
    result = SimpleNamespace(result="the result")
    recovered = "brass", result, "the library", SimpleNamespace(name="light probe rooms/room.exr")
    monkeypatch.setattr(live, "_recovered", lambda options: recovered)
    monkeypatch.setattr("torchbrdf.commands._reconstruction.summary", lambda fitted: "a summary")
    return stand_in(monkeypatch, spheres)


def stand_in(monkeypatch, spheres):
    made = []
    relighter = SimpleNamespace(of=lambda *arguments: made.append(arguments) or spheres)
    monkeypatch.setattr("torchbrdf.live.Relighter", relighter)
    return made


def interrupt_instead_of_browser(monkeypatch):
    """The page is fetched where a browser would open it, then Ctrl-C is pressed; returns addresses and pages."""
    opened, seen = [], []

    def open_browser(url):
        opened.append(url)
        seen.append(ask(at(url), "/")[1].decode())
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    monkeypatch.setattr("webbrowser.open", open_browser)
    return opened, seen


def at(url):
    return SimpleNamespace(server_address=("127.0.0.1", int(url.rstrip("/").rpartition(":")[2])))


needs_signals = pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals to send on this system")


@needs_signals
def test_ctrl_c_ends_it_with_status_0(capsys, monkeypatch, spheres):
    made = pretend(monkeypatch, spheres)
    opened, seen = interrupt_instead_of_browser(monkeypatch)
    assert main(["live", "--pixels", "32"]) == 0
    captured = capsys.readouterr()
    assert captured.out == f"a summary\n{opened[0]} shows it; Ctrl-C ends it\n"
    assert captured.err == ""
    assert "<h1>brass</h1>" in seen[0]
    assert "Under room.exr." in seen[0]
    assert made[0][0] == "the library"
    assert made[0][1] == "the result"
    assert made[0][3] == 32
    with pytest.raises(ConnectionRefusedError):
        ask(at(opened[0]), "/")


@needs_signals
@pytest.mark.filterwarnings("ignore:.*material class:UserWarning")
def test_a_photograph_is_fitted_and_turned_under_another_light(
    capsys, monkeypatch, spheres, tmp_path, merl_directory, tiny_tables
):
    probe, view = LightProbe.default(16), SphereView(16)
    probe.save(tmp_path / "room.exr")
    write_image(tmp_path / "ball.exr", render(tiny_tables["red"], probe, view, samples=64))
    write_image(tmp_path / "angular.exr", torch.ones(3, 8, 8))
    made = stand_in(monkeypatch, spheres)
    _, seen = interrupt_instead_of_browser(monkeypatch)
    arguments = [tmp_path / "ball.exr", "--probe", tmp_path / "room.exr", "--library", merl_directory]
    arguments += ["--penalty", "paper"]
    more = ["--light", tmp_path / "angular.exr", "--light-layout", "angular"]
    for light in ([], more):
        assert main(["live", *map(str, arguments + light)]) == 0
        assert capsys.readouterr().out.startswith("class ")
    (library, result, same, size), (_, _, other, _) = made
    assert result.posteriors is None
    assert (library.source, library.names, size) == (result.library, result.names, 128)
    assert torch.equal(same.radiance, probe.radiance)
    assert other.name.endswith("angular.exr")
    assert other.reading.startswith("angular, ")
    assert "<h1>ball.exr</h1>" in seen[0]
    assert ("Under room.exr." in seen[0], "Under angular.exr." in seen[1]) == (True, True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--port", "65536"], "argument --port: must be a whole number from 0 to 65535, got 65536"),
        (["--port", "x"], "argument --port: must be a whole number from 0 to 65535, got x"),
        (["--pixels", "8"], "argument --pixels: must be a whole number from 16 to 512, got 8"),
    ],
)
def test_bad_numbers(capsys, arguments, message):
    with pytest.raises(SystemExit, match="2"):
        main(["live", *arguments])
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ball.exr"], "a photograph needs the light probe of its light: give --probe"),
        (["--probe", "default"], "--probe is for a photograph, and none is given"),
        (["--circle", "1", "2", "3"], "--circle is for a photograph, and none is given"),
        (["--view", "bunny.ply"], "--view is for a photograph, and none is given"),
    ],
)
def test_inputs_that_do_not_belong_together(capsys, monkeypatch, arguments, message):
    monkeypatch.setattr("torchbrdf.live.Relighter", None)
    assert main(["live", *arguments]) == 2
    assert capsys.readouterr().err == f"torchbrdf: error: {message}\n"


def test_a_table_is_no_photograph(capsys, tmp_path):
    for path in (tmp_path, tmp_path / "brass.binary"):
        assert main(["live", str(path)]) == 2
        assert capsys.readouterr().err.startswith(f"torchbrdf: error: {path}: live takes a photograph, with")


PIXELS = """index => {
  const canvas = document.querySelector(`canvas[data-picture="${index}"]`);
  return Array.from(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data);
}"""


@pytest.fixture
def tab(server, browser):
    tab = browser.new_page(viewport={"width": 1064, "height": 900})
    tab.complaints, tab.requests = [], []
    tab.on("console", lambda message: tab.complaints.append(message.text))
    tab.on("pageerror", lambda error: tab.complaints.append(str(error)))
    tab.on("request", lambda request: tab.requests.append(request.url))
    tab.goto(server.url)
    settle(tab)
    return tab


def settle(tab):
    """Wait until frames stop coming."""
    before = -1
    while (now := int(tab.inner_text("#frames"))) != before or now == 0:
        before = now
        tab.wait_for_timeout(150)
    return before


def picture(tab, index):
    return np.array(tab.evaluate(PIXELS, index)).reshape(SIZE, SIZE, 4)


def highlight(tab, index=0):
    """Column and row of the middle of what is white, from -1 to 1."""
    rows, columns = np.nonzero(picture(tab, index)[..., :3].min(-1) > 250)
    return columns.mean() / SIZE * 2 - 1, rows.mean() / SIZE * 2 - 1


def drag(tab, start, end, index=0, button="left", steps=12):
    """A real drag over a sphere, from and to places in units of its radius, right and down; yields at every step."""
    box = tab.locator(f'canvas[data-picture="{index}"]').bounding_box()
    places = np.linspace(start, end, steps + 1)
    at = [(box["x"] + box["width"] * (1 + x) / 2, box["y"] + box["height"] * (1 + y) / 2) for x, y in places]
    tab.mouse.move(*at[0])
    tab.mouse.down(button=button)
    for place in at[1:]:
        tab.mouse.move(*place)
        yield
    tab.mouse.up(button=button)


def turned(spheres):
    """The rotation that was rendered last."""
    rotation = spheres.rotations[-1].double()
    assert torch.allclose(rotation @ rotation.T, torch.eye(3).double(), atol=1e-6)
    assert float(torch.linalg.det(rotation)) == pytest.approx(1, abs=1e-6)
    return rotation


def about(axis, angle):
    """The rotation by an angle about X, Y or Z."""
    spin = torch.zeros(3, 3, dtype=torch.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    spin[j, i], spin[i, j] = angle, -angle
    return torch.linalg.matrix_exp(spin)


def test_a_drag_to_the_right_takes_the_reflection_along(server, spheres, tab):
    shown, frames = [picture(tab, index) for index in range(4)], int(tab.inner_text("#frames"))
    x, y = highlight(tab)
    during = []
    for _ in drag(tab, (x, y), (x + 0.3, y)):
        tab.wait_for_timeout(30)
        during.append(picture(tab, 0))
    assert sum((a != b).any() for a, b in pairwise(during)) >= 6
    assert settle(tab) >= frames + 6
    assert torch.allclose(turned(spheres), about(1, 0.6), atol=0.02)
    assert turned(spheres)[0, 2] > 0, "light from the camera does not go to the right"
    for index in range(4):
        assert (picture(tab, index) != shown[index]).any()
    moved = highlight(tab)
    assert moved[0] - x == pytest.approx(0.3, abs=0.1)
    assert abs(moved[1] - y) < 0.1
    assert highlight(tab, 3)[0] > x + 0.15, "the mirror ball turns the other way"
    assert tab.complaints == []
    assert all(url.startswith((server.url, "data:")) for url in tab.requests)
    wider = tab.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth")
    assert not wider, "the page scrolls sideways"


def test_down_and_about_the_line_of_sight(spheres, tab):
    for _ in drag(tab, (0, 0), (0, 0.25), index=1):
        pass
    settle(tab)
    assert torch.allclose(turned(spheres), about(0, 0.5), atol=0.02)
    tab.click("#reset")
    settle(tab)
    assert torch.equal(turned(spheres), torch.eye(3).double())
    for _ in drag(tab, (0.8, 0), (0.8, -0.4), index=2, button="right"):
        pass
    settle(tab)
    counterclockwise = turned(spheres)
    assert counterclockwise[1, 0] > 0.3
    assert torch.allclose(counterclockwise[2], torch.tensor([0.0, 0, 1]).double(), atol=1e-6)
    tab.dblclick('canvas[data-picture="3"]')
    settle(tab)
    assert torch.equal(turned(spheres), torch.eye(3).double())
    tab.keyboard.down("Shift")
    for _ in drag(tab, (0.8, 0), (0.8, 0.4)):
        pass
    tab.keyboard.up("Shift")
    settle(tab)
    assert torch.allclose(turned(spheres), counterclockwise.T, atol=0.02)
    assert tab.complaints == []


def test_the_keys(spheres, tab):
    tab.focus('canvas[data-picture="0"]')
    expected = torch.eye(3).double()
    step = math.pi / 36
    for key, axis, angle in (
        ("ArrowRight", 1, step),
        ("ArrowDown", 0, step),
        ("ArrowUp", 0, -step),
        ("ArrowUp", 0, -step),
        ("ArrowLeft", 1, -step),
        ("Shift+ArrowLeft", 2, step),
        ("Shift+ArrowLeft", 2, step),
        ("Shift+ArrowRight", 2, -step),
    ):
        tab.keyboard.press(key)
        expected = about(axis, angle) @ expected
        settle(tab)
        assert torch.allclose(turned(spheres), expected, atol=1e-6)
    tab.keyboard.press("Home")
    settle(tab)
    assert torch.equal(turned(spheres), torch.eye(3).double())
    tab.focus("#stops")
    before = picture(tab, 0)
    tab.keyboard.press("ArrowRight")
    settle(tab)
    assert tab.inner_text("#exposure") == "+0.25 stops"
    assert (picture(tab, 0)[..., :3].sum() > before[..., :3].sum()).all()


def test_a_finger_turns_it_too(spheres, tab):
    box = tab.locator('canvas[data-picture="0"]').bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch = tab.context.new_cdp_session(tab)
    for kind, places in (
        ("touchStart", [x]),
        *(("touchMove", [x + step * box["width"] / 40]) for step in range(1, 6)),
        ("touchEnd", []),
    ):
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": at, "y": y} for at in places]})
    settle(tab)
    assert torch.allclose(turned(spheres), about(1, 0.5), atol=0.02)


def test_one_request_at_a_time_and_the_last_rotation_wins(spheres, tab):
    """Moves that come while a frame is rendered wait for it; the last of them is shown."""
    render, dragged = spheres.render, threading.Event()
    spheres.render = lambda rotation: dragged.wait(30) and render(rotation)
    before = len(spheres.rotations)
    for _ in drag(tab, (-0.5, 0), (0.5, 0), steps=30):
        pass
    tab.wait_for_timeout(100)
    dragged.set()
    settle(tab)
    assert len(spheres.rotations) == before + 2
    assert torch.allclose(turned(spheres), about(1, 2.0), atol=0.03)


def test_a_long_drag_stays_a_rotation(spheres, tab):
    for _ in range(4):
        for _ in drag(tab, (-0.6, -0.5), (0.5, 0.7), steps=30):
            pass
        for _ in drag(tab, (0.6, 0.2), (-0.5, 0.1), index=1, steps=30):
            pass
    settle(tab)
    turned(spheres)
    assert len(spheres.rotations) > 30


@pytest.mark.parametrize("asked", [True, False])
def test_a_server_that_goes_away_is_noticed_and_its_return_too(server, spheres, tab, asked):
    assert not tab.is_visible("#problem")
    server.shutdown()
    server.server_close()
    if asked:
        tab.focus('canvas[data-picture="0"]')
        tab.keyboard.press("ArrowRight")
    tab.wait_for_selector("#problem", state="visible", timeout=15_000)
    assert tab.inner_text("#problem").startswith("The server has gone. Start torchbrdf live again")
    with LiveServer(spheres, listen(server.server_address[1]), "brass", "room") as again:
        thread = threading.Thread(target=again.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        tab.wait_for_selector("#problem", state="hidden", timeout=15_000)
        again.shutdown()
        thread.join()


def test_a_server_with_other_pictures_is_another(server, spheres, tab):
    spheres.render = lambda rotation: Spheres.render(spheres, rotation)[:2]
    with LiveServer(spheres, listen(), "brass", "room") as other:
        server._gains = other._gains
    tab.focus('canvas[data-picture="0"]')
    tab.keyboard.press("ArrowRight")
    tab.wait_for_selector("#problem", state="visible", timeout=10_000)
    assert tab.inner_text("#problem") == "Another result is served here now: reload the page."
