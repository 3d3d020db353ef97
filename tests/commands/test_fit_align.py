"""`torchbrdf fit --align`: what it writes and prints, options that do not go together, failures that leave nothing."""

import json
import warnings
from pathlib import Path

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from failures import assert_fit_fails
from torchbrdf.cli import main, parser
from torchbrdf.report.grade import GRADES
from torchbrdf.report.report import Verdict
from turns import degrees_between, turn_about

TURN = turn_about((1, -2, 1.5), 4)
FIT = {"brdf.binary", "fitted.exr", "report.html", "weights.json"}
ALIGNED = FIT | {"alignment.json", "aligned_probe.exr"}


@pytest.fixture
def photo(tmp_path: Path, photographs: dict[str, Tensor]) -> Path:
    """Glossy paint under the default probe."""
    tb.write_image(tmp_path / "photo.exr", photographs["paint"])
    return tmp_path / "photo.exr"


@pytest.fixture
def turned_probe(tmp_path: Path) -> Path:
    """The probe as it was captured: turned away."""
    tb.LightProbe.default(64).rotated(TURN.T).save(tmp_path / "probe.exr")
    return tmp_path / "probe.exr"


@pytest.fixture
def short_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only its settings: the whole report takes longer than all the rest."""

    def write(path: Path, _: object, settings: dict[str, str], **__: object) -> Verdict:
        path.write_text(json.dumps(settings))
        return Verdict(GRADES["Good"], [])

    monkeypatch.setattr("torchbrdf.commands._results.write_report", write)


def run(photo: Path, probe: Path, library: Path, output: Path, *more: str) -> int:
    files = ["--probe", str(probe), "--library", str(library), "-o", str(output)]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*material class")
        return main(["fit", str(photo), *files, *more])


@pytest.mark.usefixtures("precomputed_library", "short_report")
def test_aligns_and_fits(
    photo: Path,
    turned_probe: Path,
    precomputed_directory: Path,
    photographs: dict[str, Tensor],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    assert run(photo, turned_probe, precomputed_directory, out, "--align") == 0
    assert {path.name for path in out.iterdir()} == ALIGNED
    record = json.loads((out / "alignment.json").read_text())
    assert record["turned"] is True
    rotation = torch.tensor(record["rotation"], dtype=torch.float64)
    assert degrees_between(rotation, TURN) < 0.3
    assert record["degrees"] == pytest.approx(degrees_between(rotation, torch.eye(3)), abs=1e-6)
    assert 0 < record["standard_deviation_degrees"] < 0.5  # with what the silhouette of a tight crop leaves open
    assert record["confident"] is True
    assert record["log_odds"] > 0
    assert record["blur_degrees"] == 0
    assert record["exposure"] is record["exposure_log_std"] is None
    silhouette = record["silhouette"]
    assert (silhouette["x"], silhouette["y"], silhouette["radius"]) == pytest.approx((24, 24, 24), abs=0.1)
    assert silhouette["moved"] is (silhouette["log_gain"] > 3)
    assert 0 < max(silhouette["standard_deviations"]) < 1

    given = tb.LightProbe.open(turned_probe)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        written = tb.LightProbe.open(out / "aligned_probe.exr")
    expected = given.rotated(rotation).radiance
    assert float((written.radiance - expected).norm() / expected.norm()) < 2e-3  # half floats
    assert written.reading == "rows from pole to pole, as the file says"

    printed = capsys.readouterr().out.splitlines()
    assert printed[2].startswith(f"light probe turned by {record['degrees']:.2f} degrees about (")
    names = "alignment.json, aligned_probe.exr, brdf.binary, weights.json, fitted.exr and report.html"
    assert printed[-1] == f"wrote {out}/{names}"
    assert json.loads((out / "report.html").read_text())["alignment"] == printed[2]
    assert json.loads((out / "weights.json").read_text())["relative_error"] < 0.015
    image = tb.read_image(out / "fitted.exr")
    assert float((image - photographs["paint"]).norm() / image.norm()) < 0.03


@pytest.mark.usefixtures("precomputed_library", "short_report")
def test_without_alignment(photo: Path, turned_probe: Path, precomputed_directory: Path, tmp_path: Path) -> None:
    """The probe as it is explains the photograph worse, and there is nothing to write of an alignment."""
    out = tmp_path / "out"
    assert run(photo, turned_probe, precomputed_directory, out) == 0
    assert {path.name for path in out.iterdir()} == FIT
    assert json.loads((out / "weights.json").read_text())["relative_error"] > 0.025


@pytest.mark.usefixtures("precomputed_library", "short_report")
def test_divides_by_the_exposure(
    photographs: dict[str, Tensor], precomputed_directory: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a white balance and a blur: what is fitted is the photograph divided by the factors."""
    gains = torch.tensor([3.0, 1.0, 0.4])
    photo, probe, out = tmp_path / "photo.exr", tmp_path / "probe.exr", tmp_path / "out"
    tb.write_image(photo, gains[:, None, None] * photographs["satin"])
    tb.LightProbe.default(64).save(probe)
    assert run(photo, probe, precomputed_directory, out, "--align", "--white-balance", "--blur") == 0
    record = json.loads((out / "alignment.json").read_text())
    factors = torch.tensor(record["exposure"])
    assert factors[0] > 1.1 * factors[1] > 1.2 * factors[2]
    assert min(record["exposure_log_std"]) > 0
    assert (record["turned"], record["degrees"], record["blur_degrees"]) == (False, 0, 0)
    torch.testing.assert_close(torch.tensor(record["rotation"]), torch.eye(3))
    fitted = tb.read_image(out / "fitted.exr")
    expected = photographs["satin"] * (gains / factors)[:, None, None]
    assert float((fitted - expected).norm() / expected.norm()) < 0.03
    line = capsys.readouterr().out.splitlines()[2]
    assert line.startswith("light probe left as it is: ")
    assert f"; exposure of R, G, B: {factors[0]:.2f} +- " in line


@pytest.mark.parametrize(
    "options",
    [
        ["--search", "near"],
        ["--search", "full"],
        ["--keep-silhouette"],
        ["--blur"],
        ["--exposure"],
        ["--white-balance"],
    ],
)
def test_parts_of_an_alignment_that_is_not_asked_for(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, photo: Path, options: list[str]
) -> None:
    line = assert_fit_fails(capsys, tmp_path, photo, *options)
    assert line == f"torchbrdf: error: {options[0]} is a part of the alignment: give --align, too"


def test_images_under_the_probe_as_it_is(capsys: pytest.CaptureFixture[str], tmp_path: Path, photo: Path) -> None:
    line = assert_fit_fails(capsys, tmp_path, photo, "--align", "--basis", tmp_path / "basis.safetensors")
    text = "--basis holds images under the probe as it is, and --align turns it: leave one of them out"
    assert line == f"torchbrdf: error: {text}"


@pytest.mark.usefixtures("precomputed_library")
def test_perspective(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, photo: Path, precomputed_directory: Path
) -> None:
    """One line that names the view, nothing about backends, which `fit` does not have; no output."""
    library = ["--library", precomputed_directory]
    line = assert_fit_fails(capsys, tmp_path, photo, "--align", "--fov", "40", *library)
    assert "radii from the ball's middle, nearer than" in line
    assert "backend" not in line


def test_unknown_search(capsys: pytest.CaptureFixture[str], photo: Path) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["fit", str(photo), "--probe", "default", "--align", "--search", "far", "-o", "out"])
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("torchbrdf: error: argument --search: invalid choice: 'far'")


def test_what_is_not_asked_for(photo: Path) -> None:
    """By default the probe stays as it is."""
    required = ["fit", str(photo), "--probe", "default", "-o", "out"]
    options = parser().parse_args(required)
    assert not any((options.align, options.blur, options.exposure, options.white_balance))
    assert options.search is None


def test_other_commands_do_not_align(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["demo", "--align", "-o", "out"])
    assert "--align" in capsys.readouterr().err
