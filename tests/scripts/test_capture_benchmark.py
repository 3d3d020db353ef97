"""scripts/benchmarks/capture.py: what is run, what is scored, what the table says."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

import capture as benchmark
import capture_stages
import torchbrdf as tb
from capture_stages import BY_HAND, IDEAL, STAGES, Capture, run_commands, stages
from materials import TINY_MATERIALS
from torchbrdf.experiments import Target
from torchbrdf.transport import DEFAULT_SAMPLES

TRUTH = {
    "plan": {"name": "one"},
    "material": "felt",
    "probe": "dawn",
    "fov_deg": 24.0,
    "ball": {"circle": [100.0, 50.0, 20.0]},
    "chrome": {"circle": [101.0, 51.0, 21.0], "reflectance": 1.0},
    "chrome60": {"circle": [102.0, 52.0, 22.0], "reflectance": 0.6},
    "photo_brackets": [{"file": "photo_0.jpg"}, {"file": "photo_1.jpg"}],
    "chrome_brackets": [{"file": "chrome_0.jpg"}],
}


def commands(name: str, by_hand: bool = False) -> list[str]:
    (stage,) = (stage for stage in [*STAGES, BY_HAND] if stage.name == name)
    capture = Capture(Path("in"), TRUTH, Path("out"), by_hand, ("--library", "merl"))
    return [" ".join(command) for command in stage.commands(capture)]


def case(error: float | None, *warnings: str, seconds: float = 1.0) -> dict[str, Any]:
    return {
        "error": error,
        "warnings": list(warnings),
        "seconds": seconds,
        "message": "fit: error: no ball" if error is None else None,
    }


@pytest.fixture(scope="module")
def table() -> tb.MerlTable:
    return tb.MerlTable.from_function(TINY_MATERIALS["red"], "red")


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch):
    """A program in the place of torchbrdf."""

    def use(code: str) -> None:
        monkeypatch.setattr(capture_stages, "PROGRAM", (sys.executable, "-c", code))

    capture_stages.is_available.cache_clear()
    yield use
    capture_stages.is_available.cache_clear()


# Commands


def test_the_ideal_is_fitted_as_it_is():
    assert commands(IDEAL) == ["fit in/ideal.exr --probe in/probe.exr --library merl -o out"]


def test_a_photograph_needs_only_its_field_of_view():
    expected = ["fit in/photo.exr --probe in/probe.exr --fov 24 --library merl -o out"]
    assert commands("photograph, true probe") == expected


def test_by_hand_the_circle_is_given():
    (command,) = commands("photograph, true probe", by_hand=True)
    assert "--circle 100.000 50.000 20.000" in command


def test_brackets_are_merged_before_the_mirror_ball_is_unwrapped_and_the_ball_fitted():
    assert commands("8-bit brackets of both") == [
        "merge in/chrome_0.jpg -o out/chrome.exr",
        "merge in/photo_0.jpg in/photo_1.jpg --like out/chrome.exr -o out/photo.exr",
        "probe out/chrome.exr --fov 24 --mirror-reflectance 1 -o out/probe.exr",
        "fit out/photo.exr --probe out/probe.exr --fov 24 --library merl -o out",
    ]


def test_the_reflectance_of_a_mirror_ball_is_given():
    first, _ = commands("mirror ball of 60 % elsewhere")
    assert first == "probe in/chrome60.exr --fov 24 --mirror-reflectance 0.6 -o out/probe.exr"


def test_by_hand_nothing_needs_to_be_found_and_the_mirror_ball_is_read_by_fit():
    needs = {need for stage in stages(by_hand=True) for need in stage.needs}
    assert needs == {"probe", "merge"}
    (command,) = commands(BY_HAND.name, by_hand=True)
    assert "--probe in/chrome.exr" in command
    assert "--probe-circle 101.000 51.000 21.000" in command


# Running


def test_warnings_are_collected_from_all_commands(program):
    program("import sys; print('torchbrdf: warning: ' + sys.argv[1], file=sys.stderr)")
    ran = run_commands([["dark"], ["small"]])
    assert (ran.warnings, ran.message) == (["dark", "small"], None)


def test_what_a_command_refuses_ends_the_stage(program):
    program("import sys; print('torchbrdf: error: no ball in ' + sys.argv[1], file=sys.stderr); sys.exit(2)")
    assert run_commands([["x"], ["y"]]).message == "x: torchbrdf: error: no ball in x"


def test_an_option_that_the_help_does_not_show_is_not_available(program):
    program("import sys; sys.exit(sys.argv[1] != 'fit') or print('--ball N')")
    assert capture_stages.is_available("fit")
    assert not capture_stages.is_available("merge")


def test_a_command_is_available_with_an_option_that_its_help_shows(program):
    program("import sys; print('--ball N')")
    assert capture_stages.is_available("fit --ball")
    assert not capture_stages.is_available("fit --circles")


# Scores


def test_the_error_is_the_mean_over_lights_of_the_tables_renderings(table: tb.MerlTable):
    room = tb.LightProbe.default(16)
    lit = {"a": room, "b": room.rotated(torch.diag(torch.tensor([-1.0, 1.0, -1.0])))}
    view = tb.SphereView(12)
    targets = {
        name: Target("red", name, "", factor * tb.render(table, light, view, DEFAULT_SAMPLES, seed=3000), 0.0, {})
        for (name, light), factor in zip(lit.items(), (1.0, 2.0), strict=True)
    }
    error = capture_stages.novel_error(table, lit, targets)
    assert error == pytest.approx((0 + 0.5) / 2, abs=1e-6)


def test_a_line_compares_with_the_ideal_of_the_same_captures():
    ideal = {"a": case(0.02), "b": case(0.04), "c": case(0.5)}
    found = {"a": case(0.03), "b": case(0.09, "dark"), "c": case(None, seconds=5.0)}
    assert benchmark.line("photo", found, ideal) == [
        "photo", "3", "6.00", "6.00", "9.00", "2.00", "2.25", "1", "1", "0", "0", "1.0", "5.0",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("error", "warnings", "expected"), [(0.04, [], True), (0.04, ["x"], False), (0.039, [], False)]
)
def test_silent_is_what_is_twice_as_bad_and_says_nothing(error: float, warnings: list[str], expected: bool):
    assert benchmark.silent(case(error, *warnings), case(0.02)) is expected


@pytest.mark.parametrize(("warning", "expected"), [("7.5 % unexplained", True), ("the ball may be elsewhere", False)])
def test_a_warning_that_the_ideal_has_with_another_number_tells_nothing(warning: str, expected: bool):
    assert benchmark.says_no_more(case(0.5, warning), case(0.02, "2.25 % unexplained", "dark")) is expected


def test_the_report_says_what_is_not_available_what_refused_and_what_is_silent():
    found = {IDEAL: {"a": case(0.02), "b": case(0.02)}, "photo": {"a": case(None), "b": case(0.2)}}
    text = benchmark.report(found, [BY_HAND])
    assert f"| {BY_HAND.name} | not available |" in text
    assert "| a | 2.00 | refused |" in text
    assert "| b | 2.00 | 20.00 silent |" in text
    assert "- photo, a: fit: error: no ball" in text
    assert "- photo, b: nothing was said" in text


def test_a_folder_without_captures_or_targets_is_refused(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="no captures here"):
        benchmark.truths_of(tmp_path)
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "truth.json").write_text(json.dumps(TRUTH))
    with pytest.raises(FileNotFoundError, match="no targets of felt, which one shows"):
        benchmark.truths_of(tmp_path)


def test_a_stage_is_run_and_scored_and_not_run_again(program, tmp_path: Path, table: tb.MerlTable, capsys):
    room, view = tb.LightProbe.default(16), tb.SphereView(12)
    table.save(tmp_path / "brdf.binary")
    root = tmp_path / "captures"
    for name in ("dawn", "noon"):
        (root / "targets" / name).mkdir(parents=True)
        (root / "lights").mkdir(exist_ok=True)
        room.save(root / "lights" / f"{name}.exr")
        image = tb.render(table, room, view, DEFAULT_SAMPLES, seed=3000)
        metadata = {"format": "torchbrdf target 1", "material": "felt", "probe": name, "noise": "0"}
        metadata["probe_fingerprint"] = room.fingerprint
        tb.write_image(root / "targets" / name / "felt.exr", image, metadata)
    (root / "one").mkdir()
    (root / "one" / "truth.json").write_text(json.dumps(TRUTH))
    fits = f"import shutil, sys; shutil.copy({str(tmp_path / 'brdf.binary')!r}, sys.argv[-1])"
    program(fits)
    options = [str(root), "--stages", "ideal", "--processes", "1", "-o", str(tmp_path / "out")]
    assert benchmark.main(options) == 0
    first = capsys.readouterr().out
    assert f"| {IDEAL} | 1 | 0.00 |" in first
    program("raise SystemExit(1)")
    assert benchmark.main(options) == 0
    assert capsys.readouterr().out == first


def test_only_what_is_asked_for_needs_targets_and_what_is_not_there_is_named(tmp_path: Path):
    for name, material in (("one", "felt"), ("two", "silk")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "truth.json").write_text(json.dumps(TRUTH | {"material": material}))
    (tmp_path / "targets" / "dawn").mkdir(parents=True)
    (tmp_path / "targets" / "dawn" / "felt.exr").touch()
    assert list(benchmark.truths_of(tmp_path, ["one"])) == ["one"]
    with pytest.raises(ValueError, match="--only three: there are one, two"):
        benchmark.truths_of(tmp_path, ["three"])
