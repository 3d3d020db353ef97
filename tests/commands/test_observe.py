"""`torchbrdf observe`."""

import json
from pathlib import Path

import pytest

import torchbrdf as tb
from torchbrdf.cli import main
from torchbrdf.commands import _suggestions
from torchbrdf.transport import sampled_basis


def observe(library: Path, *more: object) -> int:
    return main(["observe", "--probe", "default", "--library", str(library), "--size", "16", *map(str, more)])


def test_says_what_to_expect_in_one_line(merl_directory, capsys):
    assert observe(merl_directory) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert "gloss from albedo" in line
    assert " % under other light (dull " in line


def test_what_is_for_the_rehearsal_alone_takes_few_samples(merl_directory, monkeypatch):
    """Where the library's transport is not prepared: seven lights took a minute and a half."""
    asked = []

    def render(
        library: tb.MaterialLibrary, probe: tb.LightProbe, view: tb.View, samples: int | None = None, **_: object
    ) -> tb.BasisImages:
        asked.append(samples)
        return sampled_basis(library, probe, view, 64)

    monkeypatch.setattr("torchbrdf.rendering.render_basis", render)
    assert observe(merl_directory) == 0
    assert asked == [None, *[512] * 6]


def test_json_with_suggestions(merl_directory, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(_suggestions, "_TURNS", (90,))
    monkeypatch.setattr(_suggestions, "_LAMPS", {"above": (0.0, 1.0, 0.2)})
    uniform = tmp_path / "uniform.exr"
    tb.write_image(uniform, tb.LightProbe.default(32).radiance * 0 + 1)
    assert observe(merl_directory, "--suggest", "--probes", uniform, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert 0 < told["predicted_error"] < 1
    assert set(told["predicted_error_by_kind"]) == {"dull", "glossy", "mirror-like"}
    assert told["verdict"]
    what = [one["what"] for one in told["suggestions"]]
    assert sorted(what) == sorted([
        "second photograph, the camera 90 degrees round to the right",
        f"second photograph, under {uniform}",
        "a lamp above, as bright as all light",
    ])
    gains = [one["predicted_error"] / one["before"] for one in told["suggestions"]]
    assert gains == sorted(gains)


def test_the_camera_that_goes_right_sees_what_was_on_the_right():
    """The light that came from +X comes from the camera's side."""
    probe = tb.LightProbe(tb.LightProbe.default(64).radiance * 0 + 1e-3)
    lit = probe.radiance.clone()
    lit[:, 32, 32] = 1000  # +X is a quarter of the width
    seen = tb.LightProbe(lit)
    turned = tb.light.turned(seen, -90)
    peak = int(turned.radiance[0, 32].argmax())
    assert peak in (63, 64)


@pytest.mark.parametrize(
    ("more", "line"),
    [
        (("--probes", "x.exr"), "--probes names lights to choose from: give --suggest, too"),
        (("--toward", 1, 0, 0), "--toward is for a mesh, and --view is sphere"),
    ],
)
def test_refusals(merl_directory, capsys, more, line):
    assert observe(merl_directory, *more) == 2
    assert line in capsys.readouterr().err


def test_every_light_is_opened_before_anything_is_rendered(merl_directory, capsys, tmp_path, monkeypatch):
    """A bad one costs no time."""
    monkeypatch.setattr("torchbrdf.rendering.render_basis", None)
    assert observe(merl_directory, "--suggest", "--probes", tmp_path / "gone.exr") == 2
    assert "gone.exr" in capsys.readouterr().err
