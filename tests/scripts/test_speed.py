"""The benchmarks of speed: rows, processes, slopes and errors; no time is asserted."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import commands
import growth
from paths import ROOT
from speed.called import changed, timed
from speed.checkouts import Checkout
from speed.growing import Point, strangers
from speed.imports import loaded
from speed.inputs import TURNS, lamps
from speed.judging import Error, accurate, left
from speed.processes import finished, resident
from speed.references import Reference
from speed.rows import FAILED, Row, in_words, kept, report
from torchbrdf import __version__
from torchbrdf.brdf.tucker import load_default_factors
from torchbrdf.light.probe import LightProbe
from torchbrdf.view.sphere import SphereView

ROWS = [
    Row("fast", 1.0, 3.0, 1.5, None, "0.10%", "0.20%", revision="a"),
    Row("slow", 2.0, 3.0, 1.5, revision="a"),
    Row("new", None, None, 1.0, remark="cannot", revision="a"),
    Row("free", 1.0, 1.0, revision="a"),
]


@pytest.fixture(scope="module")
def version(tmp_path_factory: pytest.TempPathFactory) -> Checkout:
    return Checkout.of("now", str(ROOT), tmp_path_factory.mktemp("versions"))


def test_a_table_has_ratio_first_and_says_what_is_met():
    text = report(ROWS, "machine", "2.0", "1.0")
    assert "| fast | 3.00 | 1.00 s | 3.00 s | <= 1.50 s | met | 0.10% | 0.20% |" in text
    assert "| slow | 1.50 | 2.00 s | 3.00 s | <= 1.50 s | **missed** |" in text
    assert "Of 2 figures that were asked for, 1 are met." in text


def test_a_figure_that_is_fast_and_wrong_is_missed():
    row = replace(ROWS[0], accurate=accurate(Error(0.01, "1.00%"), 0.005))
    assert (row.verdict, row.cells()[4]) == ("**missed**: error", "<= 1.50 s, <= 0.5%")
    assert "Of 1 figures that were asked for, 0 are met." in report([row], "machine", "2.0", "1.0")


def test_rows_of_several_revisions_are_told_apart():
    text = report([ROWS[0], replace(ROWS[1], revision="b")], "machine", "2.0", "1.0")
    assert "Revision a: fast.\nRevision b: slow." in text


def test_rows_that_are_not_measured_again_stay(tmp_path: Path):
    path = tmp_path / "rows.json"
    kept(path, ROWS[:2], ["fast", "slow"])
    again = kept(path, [Row("slow", 9.0), Row("gone", 1.0)], ["slow", "fast", "other"])
    assert again == [Row("slow", 9.0), ROWS[0]]


def test_rows_before_an_interruption_are_kept(tmp_path: Path):
    def interrupted():
        yield ROWS[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept(tmp_path / "rows.json", interrupted(), ["fast"])
    assert kept(tmp_path / "rows.json", [], ["fast"]) == [ROWS[0]]


def test_seconds_have_the_unit_that_suits_them():
    assert [in_words(value) for value in (0.00163, 0.132, 14.72, 1500)] == ["1.63 ms", "0.13 s", "14.7 s", "1,500 s"]


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="memory is read from /proc")
def test_the_memory_of_a_process_is_its_own():
    """Not that of the process that starts it, which holds PyTorch; that of its children counts."""
    hold = "import time; kept = bytearray(80 << 20); time.sleep(0.3)"
    small = finished([sys.executable, "-c", "import time; time.sleep(0.1)"], {}, ROOT)
    nested = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {hold!r}])"
    assert small.peak < 40 < 80 < finished([sys.executable, "-c", nested], {}, ROOT).peak


def test_a_process_that_has_ended_takes_nothing():
    assert resident(2**22 + 1) == (0, 0)


def test_a_process_that_fails_is_heard():
    with pytest.raises(RuntimeError, match="exit status 3\nno such thing"):
        finished([sys.executable, "-c", "import sys; print('no such thing'); sys.exit(3)"], {}, ROOT)


def test_a_checkout_knows_its_version_and_what_it_offers(version: Checkout):
    assert version.name == __version__
    assert version.offers("precompute", "--orthographic")
    assert not version.offers("precompute", "--no-such-option")


def test_a_checkout_is_not_taken_for_another(tmp_path: Path):
    (tmp_path / "torchbrdf").mkdir()
    (tmp_path / "torchbrdf" / "__init__.py").write_text("__version__ = '0.0'\n")
    assert Checkout.of("rival", str(tmp_path), tmp_path).name == "0.0"


def test_a_row_that_a_version_cannot_do_says_so(version: Checkout):
    rival = replace(version, name="0.0")
    bench = commands.Bench(version, rival, judge=None)

    def work(one: Checkout) -> commands.Work | str:
        return commands.Work([["--version"]], times=1e6) if one is version else "too old"

    row = commands.measured(bench, commands.Case("version", "version", work, lambda _: 1.0), 1, {})
    assert (row.before, row.remark, row.verdict) == (None, "0.0: too old", "**missed**")


def test_a_command_that_fails_leaves_the_other_rows(version: Checkout, monkeypatch: pytest.MonkeyPatch):
    cases = [
        commands.Case("fit", name, lambda _, name=name: commands.Work([[name]])) for name in ("--wrong", "--version")
    ]
    monkeypatch.setattr(commands.Bench, "cases", lambda _: cases)
    bench = commands.Bench(version, replace(version, name="0.0"), judge=None)
    wrong, sound = commands.rows(bench, ["fit"], 1)
    assert (wrong.now, wrong.remark) == (None, FAILED)
    assert sound.now is not None


def test_a_limit_over_what_was_not_measured_is_none(version: Checkout):
    case = commands.Case("x", "x", lambda _: "cannot", lambda seconds: seconds["imports"] + 1, "imports")
    bench = commands.Bench(version, replace(version, name="0.0"), judge=None)
    assert commands.measured(bench, case, 1, {}).limit is None
    assert commands.measured(bench, case, 1, {"imports": 2.0}).limit == 3


def test_imports_are_modules_of_ours_and_packages_of_others():
    names = loaded()
    assert {"torch", "torchbrdf.light.probe"} < set(names)
    assert not {"sys", "speed", "torch.nn"} & set(names)


def points(step: str, slope: float, axis: str = "pixels") -> list[Point]:
    return [Point(axis, step, size, 1e-3 * size**slope, 100, 50, "a") for size in (200, 800, 3200, 12800)]


@pytest.mark.parametrize("slope", [0.0, 1.0, 1.7])
def test_the_slope_of_a_power_is_its_exponent(slope: float):
    assert growth.slope(points("x", slope)) == pytest.approx(slope)


def test_constant_cost_of_small_sizes_is_not_taken_for_the_slope():
    first = replace(points("x", 2.0)[0], seconds=1e6)
    assert growth.slope([first, *points("x", 2.0)[1:]]) == pytest.approx(2)


def test_growth_beyond_proportion_is_named_where_it_counts():
    linear, steep = points("linear", 1.05), points("steep", 1.5)
    assert "**Worse than linear** in pixels or photographs: steep (pixels): 1.50." in growth.verdict([*linear, *steep])
    assert growth.verdict([*linear, *points("steep", 1.5, "columns")]).startswith("No step is worse")


def test_the_report_of_growth_has_a_table_an_axis(tmp_path: Path):
    found = [*points("a", 1), *points("b", 0.5, "photographs")]
    text = growth.report(found, "machine")
    assert "| pixels: | 200 | 800 | 3,200 | 12,800 | slope |" in text
    assert "| b | 14.1 ms, 100 |" in text
    growth.draw(found, tmp_path / "growth.png")
    assert (tmp_path / "growth.png").stat().st_size > 10_000


def test_what_is_timed_gives_the_result_of_the_first_call():
    calls: list[int] = []
    seconds, first = timed(lambda k: calls.append(k) or k + 10, 3)
    assert (len(seconds), first, calls) == (3, 10, [0, 1, 2, 3])


def test_a_changed_light_is_another_light():
    probe = LightProbe.default(16)
    assert changed(probe, 0).fingerprint == probe.fingerprint
    assert len({changed(probe, k).fingerprint for k in range(5)}) == 5


def test_strangers_lie_between_embedded_materials_and_none_is_twice():
    embedded, source = load_default_factors()[1].quantised, strangers(120)
    assert len(source.names) == 120
    assert not bool((source.factors.quantised[:, :180] == source.factors.quantised[:, 180:]).all(0).any())
    assert bool((source.factors.quantised.amax(1) <= embedded.amax(1)).all())
    assert bool((source.factors.quantised.amin(1) >= embedded.amin(1)).all())


def test_small_lamps_have_most_of_the_power():
    probe = lamps(128)
    bright = probe.radiance.amax(0) > 100
    share = (probe.radiance * probe.solid_angles * bright).sum() / (probe.radiance * probe.solid_angles).sum()
    assert 0.85 < float(share) < 0.97
    assert float(bright.double().mean()) < 0.005


def test_errors_weigh_pixels_by_what_they_stand_for():
    images = torch.ones(1, 3, 2)
    reference = Reference(SphereView(8), images, torch.zeros(1), torch.tensor([1.0, 3.0]))
    found = images.clone()
    found[..., 1] += 0.1
    assert float(reference.errors(found)[0]) == pytest.approx(0.1 * (3 / 4) ** 0.5)


def test_a_rotation_that_is_found_leaves_nothing():
    assert left(TURNS["near"], "near").words == "0.00 degrees"
    assert left(torch.eye(3), "near").value == pytest.approx(4)
