"""What `torchbrdf fit` prints: the silhouette, the light, the residual, every warning; what --strict makes of them."""

import json
import re
import warnings
from argparse import Namespace
from pathlib import Path

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from discs import disc
from failures import fails
from photographs_of_balls import photographed
from picture_files import window, write_exr
from torchbrdf.cli import main
from torchbrdf.commands._capture import doubts_of_sight
from torchbrdf.commands._sight import find_silhouette
from torchbrdf.photograph import Circle, Photograph
from torchbrdf.report import Doubt
from torchbrdf.report.grade import GRADES
from torchbrdf.report.report import Verdict

SIZE = 16
UNEXPLAINED = Doubt("unexplained", "The fit leaves 89% unexplained.")


@pytest.fixture
def photo(tmp_path: Path, photographs: dict[str, Tensor]) -> Path:
    """Glossy paint under the default probe, with room around it."""
    tb.write_image(tmp_path / "photo.exr", torch.nn.functional.pad(photographs["paint"], (20, 7, 3, 9), value=0.4))
    tb.write_image(tmp_path / "mask.png", disc(60, 75, 44, 27, 24).expand(3, -1, -1).float())
    return tmp_path / "photo.exr"


@pytest.fixture
def reports(monkeypatch: pytest.MonkeyPatch) -> list[Doubt]:
    """The doubts of reports that are not made: the whole report takes longer than all the rest."""
    said: list[Doubt] = []

    def write(path: Path, *_: object, **__: object) -> Verdict:
        path.write_text("")
        return Verdict(GRADES["Good"], said)

    monkeypatch.setattr("torchbrdf.commands._results.write_report", write)
    return said


@pytest.fixture
def fit(
    precomputed_library: object,
    precomputed_directory: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
):
    """Runs the command: its exit status, and the lines of stdout and stderr.

    The photographs are without perspective, so what is said of a camera that is not known would be wrong.
    """
    monkeypatch.setattr("torchbrdf.commands._lit_sight.doubts_of_sight", lambda *_: [])

    def run(photo: Path, *more: object) -> tuple[int, list[str], list[str]]:
        tb.write_image(tmp_path / "probe.exr", tb.LightProbe.default(64).radiance, {"rows": "poles"})
        files = ["--probe", tmp_path / "probe.exr", "--library", precomputed_directory, "-o", tmp_path / "out"]
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*material class")
            status = main([str(word) for word in ("fit", photo, "--size", SIZE, *files, *more)])
        said = capsys.readouterr()
        return status, said.out.splitlines(), [line for line in said.err.splitlines() if line.startswith("torchbrdf")]

    return run


@pytest.mark.usefixtures("reports")
def test_in_five_lines_what_was_found(fit, photo):
    status, lines, errors = fit(photo, "--mask", photo.parent / "mask.png")
    assert (status, errors) == (0, [])
    assert len(lines) <= 5
    pixels = int(tb.SphereView(SIZE).mask.sum())
    found = "circle at (44.0, 27.0), radius 23.9 pixels, of the mask"
    assert lines[0] == f"photograph {photo}: {found}; {pixels} of its {pixels} pixels used, at {SIZE} x {SIZE}"
    assert lines[1].startswith(f"light {photo.parent / 'probe.exr'}")
    assert "; harmonic" in lines[1] or "; sampled" in lines[1]
    assert "relative error on the photograph " in lines[2]
    assert lines[3] == "good: pictures of it under other light are expected to be off by less than 5%"


@pytest.mark.usefixtures("reports")
def test_a_photograph_of_what_the_library_holds(fit, photo, precomputed_library):
    """Which shows how well it explains itself, and tells nothing of other materials."""
    basis = tb.render_basis(precomputed_library, tb.LightProbe.default(64), tb.SphereView(SIZE))
    name = precomputed_library.names[3]
    tb.write_image(photo, basis.image(name))
    _, lines, _ = fit(photo, "--circle", SIZE / 2, SIZE / 2, SIZE / 2)
    assert f"note: the library holds {name}, which looks the same; to test on it: --without {name}" in lines
    _, lines, _ = fit(photo, "--circle", SIZE / 2, SIZE / 2, SIZE / 2, "--without", name)
    assert not [line for line in lines if "looks the same" in line]


@pytest.mark.usefixtures("reports")
def test_a_photograph_that_says_how_it_is_read(fit, photo):
    image = torch.cat([tb.read_image(photo), tb.read_mask(photo.parent / "mask.png").float()])
    write_half_recorded(photo, image)
    status, lines, errors = fit(photo, "--strict")
    assert (status, errors) == (0, [])
    read = "its alpha is the mask; recorded 60 x 60 of its pixels"
    assert lines[0].startswith(f"photograph {photo} ({read}): circle at (")
    used, _, _, seen, *_ = lines[0].split("; ")[-1].split()
    assert 0.5 * int(seen) < int(used) < int(seen)


def write_half_recorded(path: Path, image: Tensor) -> None:
    """An .exr with alpha whose last fifteen columns were not recorded."""
    planes = {name: plane[:, :60].numpy() for name, plane in zip("RGBA", image, strict=True)}
    write_exr(path, planes, displayWindow=window(0, 0, 74, 59), dataWindow=window(0, 0, 59, 59))


@pytest.mark.usefixtures("reports")
def test_a_material_that_is_left_out_has_no_weight(fit, photo, tmp_path):
    mask, without = ("--mask", photo.parent / "mask.png"), ("--without", "gold-0.3", "--without", "red")
    assert fit(photo, *mask, *without)[0] == 0
    weights = json.loads((tmp_path / "out" / "weights.json").read_text())["weights"]
    materials = {weight["material"] for weight in weights}
    assert materials
    assert materials <= {"white", "teal", "satin-0.35", "plastic-0.1", "steel-0.15", "copper-0.08"}


def test_a_name_to_leave_out_that_the_library_lacks(fit, photo):
    status, _, errors = fit(photo, "--mask", photo.parent / "mask.png", "--without", "gold-3")
    assert status == 2
    (line,) = errors
    assert "no material 'gold-3' in this library of 8 (did you mean gold-0.3?)" in line


def test_every_warning_of_the_report_is_said(fit, photo, reports):
    reports += [UNEXPLAINED, Doubt("oscillation", "The weights\noscillate.")]
    status, _, errors = fit(photo, "--mask", photo.parent / "mask.png")
    assert status == 0
    assert errors == [
        "torchbrdf: warning: The fit leaves 89% unexplained.",
        "torchbrdf: warning: The weights oscillate.",
    ]


def test_strict_makes_a_status_of_warnings(fit, photo, reports):
    reports += [UNEXPLAINED]
    status, lines, errors = fit(photo, "--mask", photo.parent / "mask.png", "--strict")
    assert status == 3
    assert errors[-1] == "torchbrdf: 1 warning with --strict; what was written stays"
    assert lines[-1].startswith("wrote ")
    assert (photo.parent / "out" / "brdf.binary").exists()


def test_what_a_good_result_may_have_is_a_note(fit, photo, reports):
    """At the end, and nothing to --strict, nor to those who want warnings alone."""
    reports += [Doubt("class", "The photograph does not tell the class."), Doubt("clamped", "3% came out negative.")]
    mask = ("--mask", photo.parent / "mask.png", "--strict")
    status, lines, errors = fit(photo, *mask)
    assert (status, errors) == (0, [])
    assert lines[-3].startswith("wrote ")
    assert lines[-2:] == ["note: The photograph does not tell the class.", "note: 3% came out negative."]
    assert fit(photo, *mask, "--quiet") == (0, [], [])
    document = json.loads("\n".join(fit(photo, *mask, "--json")[1]))
    assert (document["warnings"], document["notes"]) == ([], [str(one) for one in reports])
    assert document["photographs"][0]["notes"] == document["notes"]


@pytest.mark.usefixtures("reports")
def test_what_takes_long_is_said(fit, photo, monkeypatch):
    """Each stage as soon as it took too long; here every one does."""
    monkeypatch.setattr("torchbrdf.progress._PATIENCE", 0.0)
    monkeypatch.setattr("torchbrdf.progress.print", lambda text, **_: said.append(text), raising=False)
    said: list[str] = []
    fit(photo, "--mask", photo.parent / "mask.png")
    assert [text.split()[0] for text in said] == ["reading", "explaining", "making"]


@pytest.mark.usefixtures("reports")
def test_without_a_mask_the_ball_is_found(fit, tmp_path):
    tb.write_image(tmp_path / "whole.exr", photographed((100, 150), [Circle(60.2, 45.1, 30.3), Circle(120, 70, 20)]))
    status, lines, errors = fit(tmp_path / "whole.exr", "--strict")
    assert (status, errors) == (0, [])
    assert lines[0].startswith(
        f"photograph {tmp_path / 'whole.exr'}: circle at (60.2, 45.1), radius 30.3 pixels, ball 1 of 2"
    )


def test_no_ball_is_refused(fit, tmp_path):
    tb.write_image(tmp_path / "wall.exr", photographed((60, 90), []))
    status, _, errors = fit(tmp_path / "wall.exr")
    assert status == 2
    assert errors[0].startswith(f"torchbrdf: error: {tmp_path / 'wall.exr'}: no ball is found")


@pytest.mark.parametrize("other", [("--circle", 44, 27, 24), ("--mask", "mask.png")])
def test_a_number_of_a_ball_needs_balls_that_are_found(fit, photo, other):
    option, *values = other
    values = [photo.parent / value if option == "--mask" else value for value in values]
    status, _, errors = fit(photo, "--ball", 2, option, *values)
    assert status == 2
    assert ": --ball 2 chooses among the balls found" in errors[0]


@pytest.mark.usefixtures("reports")
def test_the_field_of_view_is_that_of_the_whole_photograph(fit, photo):
    _, lines, _ = fit(photo, "--circle", 44, 27, 24, "--fov", 60)
    assert "radius 24.0 pixels, as given, 5.5 degrees off the axis of a camera of 60 degrees across, as " in lines[0]


class TestForScripts:
    @pytest.fixture
    def told(self, fit, photo):
        """Of the photograph with its mask: exit status, the document, and lines on stderr."""

        def run(*more: object) -> tuple[int, dict, list[str]]:
            status, lines, errors = fit(photo, "--mask", photo.parent / "mask.png", "--json", *more)
            return status, json.loads("\n".join(lines)), errors

        return run

    def test_what_was_found(self, told, photo, reports, tmp_path):
        reports += [Doubt("oscillation", "The weights oscillate.")]
        status, document, errors = told()
        (found,) = document["photographs"]
        record = json.loads((tmp_path / "out" / "weights.json").read_text())
        assert (status, document["status"], document["error"]) == (0, 0, None)
        assert (found["photograph"], found["folder"]) == (str(photo), str(tmp_path / "out"))
        assert (found["outcome"], found["error"], found["alignment"]) == ("written", None, None)
        assert (found["relative_error"], found["class"]) == (record["relative_error"], record["class"])
        assert found["class_probability"] == max(record["class_probabilities"])
        assert 0 < found["relative_std"] < 1
        assert found["grade"] == "Good"
        assert found["warnings"] == document["warnings"] == ["The weights oscillate."]
        assert errors == ["torchbrdf: warning: The weights oscillate."]
        assert found["files"] == document["files"]
        assert {Path(path) for path in found["files"]} == set((tmp_path / "out").iterdir())

    @pytest.mark.usefixtures("reports")
    def test_a_fixed_penalty_tells_no_deviation(self, told):
        """It has no posterior."""
        _, document, _ = told("--penalty", "paper")
        assert document["photographs"][0]["relative_std"] is None

    @pytest.mark.usefixtures("reports")
    def test_the_alignment(self, told, tmp_path):
        _, document, _ = told("--align", "--keep-silhouette", "--exposure")
        found = document["photographs"][0]["alignment"]
        assert found == json.loads((tmp_path / "out" / "alignment.json").read_text())
        assert len(found["exposure"]) == 3
        assert str(tmp_path / "out" / "aligned_probe.exr") in document["files"]

    def test_bad_input_writes_nothing(self, fit, tmp_path):
        tb.write_image(tmp_path / "wall.exr", photographed((60, 90), []))
        status, lines, errors = fit(tmp_path / "wall.exr", "--json")
        document = json.loads("\n".join(lines))
        assert (status, document["status"], document["files"]) == (2, 2, [])
        assert errors == [f"torchbrdf: error: {document['error']}"]
        assert "no ball is found" in document["error"]
        assert not (tmp_path / "out").exists()

    def test_quiet_says_warnings_alone(self, fit, photo, reports):
        reports += [Doubt("oscillation", "The weights oscillate.")]
        mask = photo.parent / "mask.png"
        assert fit(photo, "--mask", mask, "--quiet") == (0, [], ["torchbrdf: warning: The weights oscillate."])


def test_another_ball_than_is_given_is_a_warning(tmp_path):
    tb.write_image(tmp_path / "whole.exr", photographed((72, 96), [Circle(48.0, 36.0, 22.0)]))
    photograph = Photograph.open(tmp_path / "whole.exr")
    options = Namespace(photo=tmp_path / "whole.exr", circle=(45.0, 36.0, 22.0), mask=None, ball=None)
    seen = r"whole\.exr: circle at \(4[78]\.\d, 3[56]\.\d\), radius 2[12]\.\d pixels, .* of its rim seen is seen, and "
    given = r"circle at \(45\.0, 36\.0\), radius 22\.0 pixels is given by --circle, which is taken; is it right\?"
    with pytest.warns(UserWarning, match=seen + given):
        assert find_silhouette(options, photograph, None) == (Circle(45.0, 36.0, 22.0), "as given")


@pytest.mark.usefixtures("reports")
@pytest.mark.parametrize(("exposure", "share"), [(0.6, None), (1.6, r"\d+\.\d%")])
def test_clipped_whole_numbers_on_the_ball(fit, photo, exposure: float, share: str | None):
    """What is clipped beside the ball does not count."""
    image = exposure * tb.read_image(photo) / tb.read_image(photo)[:, tb.read_mask(photo.parent / "mask.png")[0]].max()
    image[:, :, :10] = 2
    tb.write_image(photo.with_name("few.png"), image)
    _, lines, errors = fit(photo.with_name("few.png"), "--mask", photo.parent / "mask.png", "--allow-ldr")
    assert "8-bit PNG decoded with gamma 2.2" in lines[0]
    said = [line for line in errors if "of the shape's pixels have the largest number that the file can hold" in line]
    assert len(said) == (share is not None)
    assert share is None or re.search(rf"few\.png: {share} of the shape's", said[0])


@pytest.mark.parametrize("name", ["x.binary", "x.EXR"])
def test_an_output_that_is_called_as_a_file(capsys, photo, name: str):
    """It became a folder of that name."""
    line = fails(capsys, "fit", photo, "--probe", "default", "-o", photo.with_name(name))
    told = "fit writes a folder of files, brdf.binary among them; give -o a name without"
    assert line.endswith(f"{name}: {told} {Path(name).suffix}")


def test_what_is_known_of_the_capture_is_said_once_and_given_to_the_report(fit, photo, monkeypatch):
    known = []

    def write(path: Path, *_: object, **given: object) -> Verdict:
        path.write_text("")
        known.extend(given["known"])
        return Verdict(GRADES["Good"], [])

    monkeypatch.setattr("torchbrdf.commands._results.write_report", write)
    monkeypatch.setattr("torchbrdf.commands._lit_sight.doubts_of_sight", doubts_of_sight)
    _, _, errors = fit(photo, "--mask", photo.parent / "mask.png")
    assert [doubt.topic for doubt in known] == ["camera"]
    assert [line for line in errors if known[0].text in line] == [f"torchbrdf: warning: {known[0].text}"]
