"""`torchbrdf render`: pictures for the eye have an exposure, files of radiance have none."""

import pytest
import torch

from failures import fails
from torchbrdf.cli import main
from torchbrdf.images import read_image
from torchbrdf.light import LightProbe


@pytest.fixture
def rendered(tiny_tables, tmp_path, capsys):
    """Render a glossy table under the default probe, scaled: the image as read again, and what was said."""
    tiny_tables["gold-0.3"].save(tmp_path / "gold.binary")

    def rendered(name: str, scale: float, *more: str):
        LightProbe.default().scaled(scale).save(tmp_path / "probe.exr")
        given = ["render", str(tmp_path / "gold.binary"), "--probe", str(tmp_path / "probe.exr"), "--size", "24"]
        assert main([*given, *more, "-o", str(tmp_path / name)]) == 0
        return read_image(tmp_path / name, allow_ldr=True), capsys.readouterr().out

    return rendered


def test_a_picture_is_exposed_whatever_the_units(rendered):
    (dim, said), (bright, _) = rendered("a.png", 1.0), rendered("b.png", 1000.0)
    assert "a.png, radiance times " in said
    assert torch.allclose(dim, bright, atol=0.02)
    assert 0.9 < float(dim.max()) <= 1.0


def test_an_exposure_that_is_asked_for(rendered):
    (one, _), (two, said) = rendered("a.png", 0.05, "--exposure", "1"), rendered("b.png", 0.05, "--exposure", "2")
    assert said.endswith("radiance times 2\n")
    lit = one > 0.05
    assert torch.allclose(two[lit], 2 * one[lit], rtol=0.1)


def test_radiance_stays_as_it_is(rendered):
    (one, said), (thousand, _) = rendered("a.exr", 1.0), rendered("b.exr", 1000.0)
    assert "times" not in said
    assert torch.allclose(1000 * one, thousand, rtol=1e-4)


def test_radiance_has_no_exposure(tiny_tables, tmp_path, capsys):
    """It was left out without a word."""
    tiny_tables["gold-0.3"].save(tmp_path / "gold.binary")
    given = ("render", tmp_path / "gold.binary", "--probe", "default", "--exposure", 2, "-o", tmp_path / "x.exr")
    line = fails(capsys, *given)
    assert line.endswith("x.exr: --exposure is of a picture to look at; name it X.png or X.jpg, or leave it out")
    assert not (tmp_path / "x.exr").exists()


def test_what_takes_long_is_said(rendered, tmp_path, monkeypatch):
    """On a slow machine; here it is."""
    said: list[str] = []
    monkeypatch.setattr("torchbrdf.progress._PATIENCE", 0.0)
    monkeypatch.setattr("torchbrdf.progress.print", lambda text, **_: said.append(text), raising=False)
    rendered("a.exr", 1.0)
    assert said == [f"rendering {tmp_path / 'gold.binary'}"]
