"""The command line: every kind of bad input gives exit status 2, one line and no output; good input gives files."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch

import torchbrdf as tb
from failures import assert_fit_fails, fails
from torchbrdf.brdf.merl import FILE_BYTES, GRID
from torchbrdf.cli import _load_torch, main, parser
from torchbrdf.commands._reconstruction import fit, summary, weights_record
from torchbrdf.estimation.lobe_bounds import LobeBounds
from torchbrdf.interruption import interruptible
from torchbrdf.photograph.observation import Observation
from torchbrdf.report.grade import GRADES
from torchbrdf.report.report import Verdict

SIZE = 16


@pytest.fixture
def photo(tmp_path):
    """A linear photograph that is good enough to reach the later checks."""
    path = tmp_path / "photo.exr"
    tb.write_image(path, torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(0)) + 0.1)
    return path


def test_missing_photograph(capsys, tmp_path):
    assert "nowhere.exr" in assert_fit_fails(capsys, tmp_path, tmp_path / "nowhere.exr")


def test_photograph_that_is_no_image(capsys, tmp_path):
    path = tmp_path / "notes.exr"
    path.write_text("these are notes")
    assert "notes.exr" in assert_fit_fails(capsys, tmp_path, path)


def test_a_layout_of_the_default_probe_is_refused_before_its_mirror_is_doubted(capsys, tmp_path, photo):
    options = ["--probe", "default", "--probe-layout", "mirror_ball", "-o", str(tmp_path / "o")]
    assert main(["fit", str(photo), *options]) == 2
    line = "torchbrdf: error: --probe-layout is for a probe from a file, and --probe is default"
    assert capsys.readouterr().err.splitlines() == [line]


def test_eight_bit_photograph(capsys, tmp_path):
    path = tmp_path / "photo.png"
    tb.write_image(path, torch.full((3, SIZE, SIZE), 0.5))
    assert "not linear HDR" in (line := assert_fit_fails(capsys, tmp_path, path))
    assert "--allow-ldr" in line


def test_wrong_channel_count(capsys, tmp_path):
    import OpenEXR

    path = tmp_path / "grey.exr"
    channels = {"Y": OpenEXR.Channel(np.ones((SIZE, SIZE), np.float32))}
    with OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))
    assert "channels" in assert_fit_fails(capsys, tmp_path, path)


def test_photograph_with_minus_infinity(capsys, tmp_path):
    """Which nothing records; infinite pixels are too bright ones, and left out."""
    path = tmp_path / "inf.exr"
    image = torch.ones(3, SIZE, SIZE)
    image[1, 8, 8] = -float("inf")
    tb.write_image(path, image)
    assert "inf.exr: NaN or infinite values in 1 of the 16 x 16 pixels" in assert_fit_fails(capsys, tmp_path, path)


def test_black_photograph(capsys, tmp_path):
    path = tmp_path / "black.exr"
    tb.write_image(path, torch.zeros(3, SIZE, SIZE))
    assert "black.exr: the ball is black" in assert_fit_fails(capsys, tmp_path, path)


def test_empty_mask(capsys, tmp_path, photo):
    path = tmp_path / "mask.png"
    tb.write_image(path, torch.zeros(3, SIZE, SIZE))
    assert "mask.png: mask is empty" in assert_fit_fails(capsys, tmp_path, photo, "--mask", path)


def test_mask_of_another_size(capsys, tmp_path, photo):
    path = tmp_path / "mask.png"
    tb.write_image(path, torch.ones(3, SIZE, SIZE + 1))
    line = assert_fit_fails(capsys, tmp_path, photo, "--mask", path)
    assert "mask must have the size of the photograph, 16 x 16, got 16 x 17" in line


def test_probe_that_is_not_two_to_one(capsys, tmp_path, photo):
    path = tmp_path / "square.exr"
    tb.write_image(path, torch.ones(3, 8, 8))
    line = assert_fit_fails(capsys, tmp_path, photo, "--probe", path)
    assert "must be lat-long (width = 2 x height), got 8 x 8" in line


def test_directory_without_materials(capsys, tmp_path, photo):
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no materials" in assert_fit_fails(capsys, tmp_path, photo, "--library", empty)


def test_output_folder_that_cannot_be_written(capsys, tmp_path, photo):
    assert "cannot write here" in fails(capsys, "fit", photo, "--probe", "default", "-o", photo / "out")


@pytest.mark.parametrize(("bytes_more", "state"), [(-8, "truncated"), (8, "oversized")])
def test_truncated_and_oversized_tables(capsys, tmp_path, bytes_more, state):
    path = tmp_path / "x.binary"
    with open(path, "wb") as file:
        np.array(GRID, "<i4").tofile(file)
        file.truncate(FILE_BYTES + bytes_more)
    line = fails(capsys, "render", path, "--probe", "default", "-o", tmp_path / "x.png")
    sizes = f"expected 34992012 bytes, got {34992012 + bytes_more}"
    assert f"{path}: {state} MERL table: {sizes}; the file is damaged: download or convert it again" in line
    assert not (tmp_path / "x.png").exists()


def test_bad_numbers_on_the_command_line(capsys, photo):
    bad = [("--penalty", "-1"), ("--penalty", "much"), ("--penalty", "nan"), ("--constraint", "sum"), ("--size", "0.5")]
    for option, value in bad:
        with pytest.raises(SystemExit, match="2"):
            main(["fit", str(photo), "--probe", "default", option, value, "-o", "out"])
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        assert lines[0].startswith("torchbrdf: error: ")


def test_the_options_of_the_estimator(photo):
    required = ["fit", str(photo), "--probe", "default", "-o", "out"]
    options = parser().parse_args(required)
    assert (options.penalty, options.constraint, options.robust) == ("auto", None, False)
    for text, value in (("auto", "auto"), ("paper", "paper"), ("0", 0.0), ("5e-4", 5e-4)):
        assert parser().parse_args([*required, "--penalty", text]).penalty == value
    options = parser().parse_args([*required, "--constraint", "energy", "--robust"])
    assert (options.constraint, options.robust) == ("energy", True)
    assert parser().parse_args([*required, "--constraint", "none"]).constraint == "none"


@pytest.mark.filterwarnings("ignore:.*material class:UserWarning")
def test_the_estimator_gets_the_options(tiny_library):
    """And weights.json and the line that is printed say what they led to."""
    probe, view = tb.LightProbe.default(32), tb.SphereView(SIZE)
    basis = tb.render_basis(tiny_library, probe, view, samples=64)
    image = basis.image("gold-0.3")
    image[:, 8, 8] = 0
    observation = Observation(image, view.mask)
    plain = fit(observation, probe, tiny_library, "auto", view, basis)
    record = weights_record(plain)
    assert (record["penalty"], record["constraint"], record["robust"]) == ("auto", "lobes", False)
    j, last = record["class"], plain.classes.n_classes - 1
    classes = f", from 0, the dullest, to {last}, mirror-like" if last else ""
    percent = f"{record['class_probabilities'][j]:.0%}"
    error = f"relative error on the photograph {record['relative_error']:.2%}"
    assert summary(plain) == f"most probably of class {j} ({percent}){classes}; {error}"

    paper = fit(observation, probe, tiny_library, "paper", view, basis)
    assert summary(paper).startswith(f"class {int(paper.result.class_index)}{classes}; ")
    assert sorted(weights_record(paper)["class_probabilities"]) == [0.0] * last + [1.0]
    assert weights_record(paper)["constraint"] is None

    free = fit(observation, probe, tiny_library, "auto", view, basis, "none")
    assert weights_record(free)["constraint"] is None
    bounds = LobeBounds.of(tiny_library).rows
    shown = bounds @ free.result.weights.double()
    assert float(shown.min()) < 0
    assert float((bounds @ plain.result.weights.double()).min()) > 0.05 * float(shown.min())

    robust = fit(observation, probe, tiny_library, "auto", view, basis, robust=True)
    assert float((robust.result.image - basis.image("gold-0.3")).norm()) < float(
        (plain.result.image - basis.image("gold-0.3")).norm()
    )
    for constraint in ("nonnegative", "convex", "energy"):
        found = fit(observation, probe, tiny_library, "auto", view, basis, constraint)
        assert weights_record(found)["constraint"] == constraint
        assert found.result.optimality is not None
        if constraint != "energy":
            assert float(found.result.weights.min()) >= -1e-6


def test_unknown_output_format(capsys, tmp_path):
    table = tmp_path / "grey.binary"
    tb.MerlTable.from_function(lambda w_i, w_o: torch.full_like(w_i, 0.1)).save(table)
    assert ".gif" in fails(capsys, "render", table, "--probe", "default", "--size", 8, "-o", tmp_path / "x.gif")
    assert fails(capsys, "render", table, "--probe", "default", "-o", tmp_path / "no" / "x.png")


def test_render_of_a_grey_ball_is_grey(capsys, tmp_path):
    table, probe = tmp_path / "grey.binary", tmp_path / "white.exr"
    tb.MerlTable.from_function(lambda w_i, w_o: torch.full_like(w_i, 0.5 / torch.pi)).save(table)
    tb.write_image(probe, torch.ones(3, 8, 16))
    sizes = ["--size", "12", "--samples", "8192"]
    assert main(["render", str(table), "--probe", str(probe), *sizes, "-o", str(tmp_path / "x.exr")]) == 0
    image = tb.read_image(tmp_path / "x.exr")
    inside = tb.SphereView(12).mask.expand(3, -1, -1)
    assert image[inside].numpy() == pytest.approx(0.5, rel=5e-3)
    assert (image[~inside] == 0).all()


def test_verify_names_sound_and_unsound(capsys, tmp_path):
    tb.MerlTable.from_function(lambda w_i, w_o: torch.full_like(w_i, 0.1)).save(tmp_path / "brass.binary")
    (tmp_path / "nylon.binary").write_bytes(b"short")
    assert main(["verify", str(tmp_path)]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "1 sound: brass"
    assert lines[1].startswith("unsound nylon: ")
    assert lines[2].startswith("  brass: MERL, f_r 0.1 to 0.1 1/sr, measured 100.0%, ")


def test_demo_recovers_a_material_that_it_does_not_know(default_library, capsys, tmp_path, monkeypatch):
    """With smaller pictures than usual."""
    for name, value in {"_demonstration.SIZE": 24, "demo.PICTURE_SIZE": 48}.items():
        monkeypatch.setattr(f"torchbrdf.commands.{name}", value)
    out = tmp_path / "demo"
    assert main(["demo", "-o", str(out)]) == 0
    names = {"brdf.binary", "fitted.exr", "novel_light.png", "photograph.exr", "report.html", "weights.json"}
    assert {path.name for path in out.iterdir()} == names
    record = json.loads((out / "weights.json").read_text())
    assert "gold-metallic-paint2" not in {entry["material"] for entry in record["weights"]}
    table = tb.MerlTable.open(out / "brdf.binary")
    assert float(table.values[table.valid].min()) >= 0
    novel = float(capsys.readouterr().out.split("observed under ")[1].split("%")[0])
    assert novel < 15


def test_fit_of_the_demo_photograph_gives_the_same_table(default_library, capsys, tmp_path, monkeypatch):
    """`fit` on a photograph of a library material, padded and masked, finds the ball and explains it.

    The report, which takes longer than all the rest, is that of the demo.
    """

    def write(path, *_, **__):
        path.write_text("")
        return Verdict(GRADES["Good"], [])

    monkeypatch.setattr("torchbrdf.commands._results.write_report", write)
    probe, view = tb.LightProbe.default(), tb.SphereView(32)
    image = tb.render(default_library.table("nylon"), probe, view, seed=5)
    padded = torch.nn.functional.pad(image, (7, 21, 12, 3), value=9.0)
    mask = torch.nn.functional.pad(torch.ones(3, 32, 32), (7, 21, 12, 3))
    rows, columns = torch.meshgrid(torch.arange(47) + 0.5, torch.arange(60) + 0.5, indexing="ij")
    mask *= ((rows - 28) ** 2 + (columns - 23) ** 2 <= 16**2).float()
    tb.write_image(tmp_path / "photo.exr", padded)
    tb.write_image(tmp_path / "mask.png", mask)
    arguments = ["fit", str(tmp_path / "photo.exr"), "--probe", "default", "--mask", str(tmp_path / "mask.png")]
    assert main([*arguments, "--circle", "23", "28", "16", "-o", str(tmp_path / "out")]) == 0
    record = json.loads((tmp_path / "out" / "weights.json").read_text())
    assert record["relative_error"] < 0.05
    assert record["penalty"] == "auto"
    assert sum(record["class_probabilities"]) == pytest.approx(1, abs=1e-5)
    assert max(record["class_probabilities"]) == record["class_probabilities"][record["class"]]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "brdf.binary", "fitted.exr", "report.html", "weights.json"
    }  # fmt: skip
    assert tb.read_image(tmp_path / "out" / "fitted.exr").shape == (3, 32, 32)


@pytest.mark.parametrize(
    "arguments",
    [
        ("merge", "kept.exr", "other.exr", "--times", "1", "2", "-o", "kept.exr"),
        ("merge", "other.exr", "--like", "kept.exr", "-o", "kept.exr"),
        ("probe", "kept.exr", "--fov", "24", "-o", "./kept.exr"),
        ("render", "other.exr", "--probe", "kept.exr", "-o", "kept.exr"),
    ],
)
def test_an_input_is_not_written_over(capsys, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    for name in ("kept.exr", "other.exr"):
        (tmp_path / name).write_bytes(b"an exposure")
    assert main(list(arguments)) == 2
    said = "kept.exr: the output is an input, which would be lost; give the output another name"
    assert capsys.readouterr().err == f"torchbrdf: error: {said}\n"
    assert (tmp_path / "kept.exr").read_bytes() == b"an exposure"


def test_a_table_of_an_input_folder_is_not_written_over(capsys, tmp_path):
    (tmp_path / "brdf.binary").write_bytes(b"a table")
    output = str(tmp_path / "brdf.binary")
    assert main(["analytic", str(tmp_path), "--model", "ggx", "-o", output]) == 2
    said = f"{output}: the output is an input, which would be lost; give the output another name"
    assert capsys.readouterr().err == f"torchbrdf: error: {said}\n"


def run_as_module(*words: str, stderr: int, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess:
    kept = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "FORCE_COLOR")}
    command = [sys.executable, "-m", "torchbrdf", *words]
    return subprocess.run(
        command, stdout=subprocess.PIPE, stderr=stderr, text=True, env=kept | {"TERM": "xterm"} | (environment or {})
    )


def test_the_package_is_the_program():
    """Under the same name."""
    assert run_as_module("--version", stderr=subprocess.PIPE).stdout == f"torchbrdf {tb.__version__}\n"
    ran = run_as_module("render", stderr=subprocess.PIPE)
    assert ran.returncode == 2
    assert ran.stderr.startswith("torchbrdf: error: the following arguments are required: BRDF")
    assert ran.stderr.endswith("; see `torchbrdf render --help`\n")


@pytest.mark.skipif(os.name != "posix", reason="this system has no pseudo-terminals")
@pytest.mark.parametrize(
    ("environment", "coloured"), [({}, True), ({"NO_COLOR": "1"}, False), ({"TERM": "dumb"}, False)]
)
def test_errors_have_a_colour_on_a_terminal(environment, coloured):
    ours, theirs = os.openpty()
    try:
        ran = run_as_module("paint", stderr=theirs, environment=environment)
        said = os.read(ours, 4096).decode()
    finally:
        os.close(ours)
        os.close(theirs)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert said.startswith("torchbrdf: \x1b[1;31merror:\x1b[0m argument" if coloured else "torchbrdf: error: argument")


def test_a_signal_while_torch_loads_is_not_lost(tmp_path, monkeypatch):
    """Initialisers of its extensions swallow what is raised in them."""
    lines = ["import contextlib, signal", "with contextlib.suppress(KeyboardInterrupt):"]
    (tmp_path / "torch.py").write_text("\n".join([*lines, "    signal.raise_signal(signal.SIGINT)", "loaded = True"]))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "torch")
    monkeypatch.setattr("gc.freeze", lambda: None)
    with pytest.raises(KeyboardInterrupt), interruptible() as interruption:
        _load_torch()
    assert interruption.received == signal.SIGINT
    assert sys.modules["torch"].loaded
