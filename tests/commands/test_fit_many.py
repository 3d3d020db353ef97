"""`torchbrdf fit` of many photographs: a folder each, what is finished, bad files, warnings, signals, one material."""

import json
import os
import re
import shutil
import signal
import warnings
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from failures import fails
from picture_files import write_exr
from torchbrdf.cli import main, parser
from torchbrdf.commands import _batch
from torchbrdf.commands._photographs import photographs
from torchbrdf.report import Doubt
from torchbrdf.report.grade import GRADES
from torchbrdf.report.report import Verdict

SIZE = 16
FILES = {"brdf.binary", "fitted.exr", "weights.json"}

Fit = Callable[..., tuple[int, list[str], list[str]]]


@pytest.fixture
def photos(tmp_path: Path, photographs: dict[str, Tensor]) -> Path:
    """A folder of two materials under the default probe, and one of them with a hole."""
    return write_photos(tmp_path / "photos", photographs)


def write_photos(folder: Path, photographs: dict[str, Tensor]) -> Path:
    folder.mkdir()
    for name in ("paint", "satin"):
        tb.write_image(folder / f"{name}.exr", photographs[name])
    alpha = tb.SphereView(48).mask.float()
    alpha[:, 20:30, 10:20] = 0
    planes = torch.cat([photographs["paint"], alpha])
    write_exr(folder / "holed.exr", {name: plane.numpy() for name, plane in zip("RGBA", planes, strict=True)})
    return folder


@pytest.fixture
def probe(tmp_path: Path) -> Path:
    tb.LightProbe.default(64).save(tmp_path / "probe.exr")
    return tmp_path / "probe.exr"


@pytest.fixture
def fit(
    precomputed_library: object,
    precomputed_directory: Path,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
):
    """Runs the command, without reports but for `--report`: its exit status, and the lines of stdout and stderr."""

    def run(*words: object, out: Path | None = None) -> tuple[int, list[str], list[str]]:
        report = [] if "--report" in words else ["--no-report"]
        words = tuple(word for word in words if word != "--report")
        files = ["--library", precomputed_directory, "--size", SIZE, *report, "-o", out or tmp_path / "out"]
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*material class")
            status = main([str(word) for word in ("fit", *words, *files)])
        said = capsys.readouterr()
        return status, said.out.splitlines(), [line for line in said.err.splitlines() if line.startswith("torchbrdf")]

    return run


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def times(out: Path) -> dict[str, int]:
    return {path.parent.name: path.stat().st_mtime_ns for path in out.glob("*/weights.json")}


def table(folder: Path) -> Tensor:
    return tb.MerlTable.open(folder / "brdf.binary").values


class TestFolders:
    def test_each_gets_what_it_gets_alone(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        """Also those that are solved together, one of them with other pixels."""
        status, lines, _ = fit(photos, "--probe", probe)
        given = sorted(path.stem for path in photos.iterdir())
        assert (status, sorted(names(tmp_path / "out"))) == (0, given)
        assert [line.split(":")[0] for line in lines[:-1]] == given
        assert lines[-1] == f"wrote {len(given)} of {len(given)} materials to {tmp_path / 'out'}/NAME"
        for name in given:
            assert names(tmp_path / "out" / name) == FILES
            alone = tmp_path / "alone" / name
            fit(photos / f"{name}.exr", "--probe", probe, out=alone)
            assert names(alone) == FILES
            torch.testing.assert_close(table(tmp_path / "out" / name), table(alone), rtol=1e-4, atol=1e-6)

    def test_several_files_are_as_their_folder(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        paint, satin = photos / "paint.exr", photos / "satin.exr"
        assert fit(paint, satin, "--probe", probe)[0] == 0
        assert names(tmp_path / "out") == {"paint", "satin"}

    def test_what_other_options_name_is_no_photograph(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        shutil.copy(probe, photos / "probe.exr")
        (photos / "notes.txt").write_text("of the day")
        for preview in ("paint.png", "probe.jpg"):
            tb.write_image(photos / preview, torch.full((3, 8, 8), 0.5))
        status, _, errors = fit(photos, "--probe", photos / "probe.exr")
        assert (status, [line for line in errors if "left out" in line]) == (0, [])
        assert names(tmp_path / "out") == {"holed", "paint", "satin"}

    @pytest.mark.parametrize("options", [("--align",), ("--same-material",)])
    def test_results_beside_them_are_no_photographs(self, photos: Path, options: tuple[str, ...]):
        """As `fit photos/paint.exr -o photos` leaves them, and of two of one material."""
        both = options == ("--same-material",)
        left = ["fitted_paint.exr", "fitted_satin.exr"] if both else ["fitted.exr", "aligned_probe.exr"]
        given = parser().parse_args(["fit", str(photos), "--probe", "default", *options, "-o", "x"])
        given.probes = given.probe
        for name in left:
            tb.write_image(photos / name, torch.ones(3, 8, 8))
        assert {Path(name).stem for name in left} < {one.name for one in photographs(given)}
        (photos / "weights.json").write_text(json.dumps({"files": left} if both else {"class": 1}))
        assert [one.name for one in photographs(given)] == ["holed", "paint", "satin"]

    def test_pictures_of_few_bits_are_left_out_and_counted(self, photos: Path):
        for name in ("clay.png", "wood.jpg"):
            tb.write_image(photos / name, torch.full((3, 8, 8), 0.5))
        options = parser().parse_args(["fit", str(photos), "--probe", "default", "-o", "x"])
        options.probes = options.probe
        told = "left out as not linear HDR: 2 of its pictures, of 8 or 16 bits, the first clay.png; --allow-ldr takes"
        with pytest.warns(UserWarning, match=told):
            assert [one.name for one in photographs(options)] == ["holed", "paint", "satin"]

    def test_a_library_that_is_not_there_is_said_once(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        status, _, errors = fit(photos, "--probe", probe, "--library", tmp_path / "gone")
        assert status == 2
        (line,) = errors
        assert line.startswith(f"torchbrdf: error: {tmp_path / 'gone'}: no such file")
        assert not (tmp_path / "out").exists()

    def test_a_probe_for_each(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        """In order: the photograph under another probe is not explained by it."""
        turned = tmp_path / "turned.exr"
        tb.LightProbe.default(64).rotated(torch.diag(torch.tensor([-1.0, 1.0, -1.0]))).save(turned)
        assert fit(photos / "paint.exr", photos / "satin.exr", "--probe", probe, "--probe", turned)[0] == 0
        records = (json.loads((tmp_path / "out" / name / "weights.json").read_text()) for name in ("paint", "satin"))
        right, wrong = (record["relative_error"] for record in records)
        assert right < 0.05 < wrong


class TestRefusals:
    def test_two_of_one_name(self, capsys: pytest.CaptureFixture[str], photos: Path, tmp_path: Path):
        (tmp_path / "more").mkdir()
        shutil.copy(photos / "paint.exr", tmp_path / "more" / "Paint.exr")
        other = tmp_path / "more" / "Paint.exr"
        line = fails(capsys, "fit", photos, other, "--probe", "default", "-o", tmp_path / "out")
        assert f"{photos / 'paint.exr'} and {other} have the same name" in line
        assert not (tmp_path / "out").exists()

    def test_one_given_twice(self, capsys: pytest.CaptureFixture[str], photos: Path, tmp_path: Path):
        line = fails(capsys, "fit", photos, photos / "paint.exr", "--probe", "default", "-o", tmp_path / "out")
        assert f"{photos / 'paint.exr'} is given twice" in line

    def test_a_folder_without_photographs(self, capsys: pytest.CaptureFixture[str], tmp_path: Path):
        (tmp_path / "empty").mkdir()
        line = fails(capsys, "fit", tmp_path / "empty", "--probe", "default", "-o", tmp_path / "out")
        assert f"{tmp_path / 'empty'}: holds no photographs" in line

    def test_photographs_in_subfolders_alone(self, capsys: pytest.CaptureFixture[str], photos: Path, tmp_path: Path):
        line = fails(capsys, "fit", photos.parent, "--probe", "default", "-o", tmp_path / "out")
        assert line.endswith(f"; subfolders are not read: name them, {photos} for one")

    @pytest.mark.parametrize(("photographs_given", "probes"), [(1, 2), (3, 2)])
    def test_neither_one_probe_nor_one_each(
        self, capsys: pytest.CaptureFixture[str], tmp_path: Path, photographs_given: int, probes: int
    ):
        given = [tmp_path / f"{i}.exr" for i in range(photographs_given)]
        line = fails(capsys, "fit", *given, *["--probe", "default"] * probes, "-o", tmp_path / "out")
        assert f"--probe is given {probes} times for {photographs_given} photographs" in line

    def test_a_probe_for_each_of_a_folder(self, capsys: pytest.CaptureFixture[str], photos: Path, tmp_path: Path):
        line = fails(capsys, "fit", photos, *["--probe", "default"] * 3, "-o", tmp_path / "out")
        assert "name the photographs in the same order" in line


def test_subfolders_are_not_read(photos: Path):
    """And that is said where they hold pictures that are not those of results."""
    given = Namespace(photos=[photos], probes=["default"], allow_ldr=False, encoding=None)
    for name in ("result", "notes", ".hidden"):
        (photos / name).mkdir()
    (photos / "notes" / "light.txt").touch()
    for name in ("result/fitted.exr", "result/brdf.binary", ".hidden/x.exr"):
        (photos / name).touch()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = photographs(given)
    (photos / "more").mkdir()
    shutil.copy(photos / "paint.exr", photos / "more")
    said = f"{photos}: subfolders are not read, and 1 of them hold pictures; name {photos / 'more'}, too"
    with pytest.warns(UserWarning, match=re.escape(said)):
        assert photographs(given) == found


def test_a_bad_file_stops_no_other(fit: Fit, photos: Path, probe: Path, tmp_path: Path):
    (photos / "broken.exr").write_text("no picture")
    tb.write_image(photos / "night.exr", torch.zeros(3, 48, 48))
    status, lines, errors = fit(photos, "--probe", probe)
    assert status == 2
    assert names(tmp_path / "out") == {"holed", "paint", "satin"}
    assert [error.split(": ")[1:3] for error in errors[-2:]] == [
        ["error", str(photos / "broken.exr")], ["error", str(photos / "night.exr")]
    ]  # fmt: skip
    assert lines[-1].endswith("; 2 failed: broken, night")


class TestForScripts:
    """One document, whatever becomes of each."""

    def test_each_is_told_of_also_what_failed(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        (photos / "broken.exr").write_text("no picture")
        status, lines, errors = fit(photos, "--probe", probe, "--json")
        document = json.loads("\n".join(lines))
        assert (status, document["status"], document["error"]) == (2, 2, "1 failed: broken")
        found = {Path(one["photograph"]).stem: one for one in document["photographs"]}
        assert list(found) == ["broken", "holed", "paint", "satin"]
        assert found["broken"].keys() == {"photograph", "outcome", "error"}
        assert errors[-1] == f"torchbrdf: error: {found['broken']['error']}"
        assert {name for name in found if found[name]["outcome"] == "written"} == {"holed", "paint", "satin"}
        for name in ("holed", "paint", "satin"):
            folder = tmp_path / "out" / name
            assert {Path(path) for path in found[name]["files"]} == set(folder.iterdir())
            record = json.loads((folder / "weights.json").read_text())
            assert found[name]["relative_error"] == record["relative_error"]
            assert found[name]["warnings"] == record["warnings"]
        assert len(document["files"]) == 3 * len(FILES)

    def test_what_was_finished_is_kept(self, fit: Fit, photos: Path, probe: Path):
        """Whether a script read the first run or a person; what the first had to compute for a script is not there."""
        fit(photos, "--probe", probe)
        document = json.loads("\n".join(fit(photos, "--probe", probe, "--json")[1]))
        assert [one["outcome"] for one in document["photographs"]] == ["kept"] * 3
        assert all(one["relative_error"] < 0.05 and one["relative_std"] is None for one in document["photographs"])
        assert document["files"] == []

    def test_photographs_of_one_material(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        given = photos / "paint.exr", photos / "satin.exr"
        document = json.loads("\n".join(fit(*given, "--same-material", "--probe", probe, "--json")[1]))
        record = json.loads((tmp_path / "out" / "weights.json").read_text())
        assert document["joint_relative_error"] == record["relative_error"]
        errors = [one["relative_error"] for one in document["photographs"]]
        assert errors == [view["relative_error"] for view in record["photographs"]]
        for one, path in zip(document["photographs"], given, strict=True):
            assert (one["photograph"], one["class"]) == (str(path), record["class"])
            assert {Path(file).name for file in one["files"]} == {
                "brdf.binary", "weights.json", f"fitted_{path.stem}.exr"
            }  # fmt: skip

    @pytest.mark.usefixtures("precomputed_library")
    @pytest.mark.filterwarnings("ignore:.*material class:UserWarning")
    def test_quiet_prints_nothing(
        self,
        precomputed_directory: Path,
        photos: Path,
        probe: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ):
        """No line, and no bar of progress."""
        given = photos / "paint.exr", photos / "satin.exr", "--probe", probe, "--library", precomputed_directory
        words = "fit", *given, "--size", SIZE, "--no-report", "--quiet", "-o", tmp_path / "out"
        assert main([str(word) for word in words]) == 0
        assert capsys.readouterr() == ("", "")
        assert names(tmp_path / "out") == {"paint", "satin"}


def test_what_all_need_is_refused_once(capsys: pytest.CaptureFixture[str], photos: Path, tmp_path: Path):
    line = fails(capsys, "fit", photos, "--probe", tmp_path / "no.exr", "--no-report", "-o", tmp_path / "out")
    assert f"{tmp_path / 'no.exr'}: no such file" in line


@pytest.fixture(scope="module")
def finished(
    precomputed_library: object,
    precomputed_directory: Path,
    photographs: dict[str, Tensor],
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """A folder of photographs, their probe, and all their results in `out`."""
    folder = tmp_path_factory.mktemp("finished")
    photos = write_photos(folder / "photos", photographs)
    tb.LightProbe.default(64).save(folder / "probe.exr")
    files = "--probe", folder / "probe.exr", "--library", precomputed_directory, "-o", folder / "out"
    words = "fit", photos, *files, "--size", SIZE, "--no-report", "--quiet"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*material class")
        assert main([str(word) for word in words]) == 0
    return folder


class TestFinished:
    @pytest.fixture
    def before(self, finished: Path, photos: Path, probe: Path, tmp_path: Path) -> dict[str, int]:
        """As if these photographs had been fitted: what a run leaves, with its times."""
        shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
        return times(tmp_path / "out")

    def redone(self, before: dict[str, int], out: Path) -> set[str]:
        after = times(out)
        return {name for name in after if after[name] != before.get(name)}

    def test_is_left_as_it_is(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, before: dict[str, int]):
        status, lines, _ = fit(photos, "--probe", probe)
        assert self.redone(before, tmp_path / "out") == set()
        kept = "3 were finished before (--overwrite makes them anew)"
        assert (status, lines) == (0, [f"wrote 0 of 3 materials to {tmp_path / 'out'}/NAME; {kept}"])

    @pytest.mark.parametrize("option", ["--overwrite", "--robust"])
    def test_is_made_anew_where_that_is_asked_for_or_otherwise(
        self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, before: dict[str, int], option: str
    ):
        fit(photos, "--probe", probe, option)
        assert self.redone(before, tmp_path / "out") == set(before)

    def test_another_photograph_of_the_name_is_not_finished(
        self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, before: dict[str, int]
    ):
        shutil.copy(photos / "satin.exr", photos / "paint.exr")
        fit(photos, "--probe", probe)
        assert self.redone(before, tmp_path / "out") == {"paint"}

    def test_another_probe_of_the_name_is_another(
        self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, before: dict[str, int]
    ):
        tb.LightProbe.default(32).save(probe)
        fit(photos, "--probe", probe)
        assert self.redone(before, tmp_path / "out") == set(before)

    def test_results_of_which_a_part_is_gone_are_not_finished(
        self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, before: dict[str, int]
    ):
        os.remove(tmp_path / "out" / "paint" / "fitted.exr")
        os.truncate(tmp_path / "out" / "satin" / "brdf.binary", 1000)
        fit(photos, "--probe", probe)
        assert self.redone(before, tmp_path / "out") == {"paint", "satin"}

    def test_another_version_is_another(
        self,
        fit: Fit,
        photos: Path,
        probe: Path,
        tmp_path: Path,
        before: dict[str, int],
        monkeypatch: pytest.MonkeyPatch,
    ):
        monkeypatch.setattr("torchbrdf.commands._finished.__version__", "0.0.1")
        fit(photos, "--probe", probe)
        assert self.redone(before, tmp_path / "out") == set(before)

    def test_its_warnings_are_said_again(
        self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, photographs: dict[str, Tensor]
    ):
        """Each with the name of its photograph; --strict sees them."""
        tb.write_image(photos / "bright.exr", 9 * photographs["paint"])
        found = [fit(photos, "--probe", probe, "--strict") for _ in range(2)]
        said = [{line for line in errors if "in different units" in line} for _, _, errors in found]
        assert said[0] == said[1]
        assert [line.split(": ")[2] for line in said[0]] == [str(photos / "bright.exr")]
        assert [status for status, _, _ in found] == [3, 3]


class TestInterruption:
    @pytest.mark.parametrize(
        ("more", "told"),
        [
            ([], "the same command goes on where it stopped"),
            (["--overwrite"], "the same command begins anew, without --overwrite it goes on where it stopped"),
        ],
    )
    def test_what_is_finished_is_whole_and_the_rest_is_not_there(
        self,
        fit: Fit,
        photos: Path,
        probe: Path,
        more: list[str],
        told: str,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ):
        """By a signal while the third is read; the same command goes on."""
        calls: list[object] = []
        original = _batch.lit_sight

        def interrupted(*arguments: object) -> object:
            calls.append(arguments)
            if len(calls) == 3:
                signal.raise_signal(signal.SIGTERM)
            return original(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(_batch, "_TOGETHER", 1)
            patch.setattr(_batch, "lit_sight", interrupted)
            status, _, errors = fit(photos, "--probe", probe, *more)
        assert (status, errors) == (143, [f"torchbrdf: interrupted; {told} (SIGTERM)"])
        finished = times(tmp_path / "out")
        assert {"holed"} <= finished.keys() < {"holed", "paint", "satin"}
        assert names(tmp_path / "out") == finished.keys()
        assert all(names(tmp_path / "out" / name) == FILES for name in finished)
        assert fit(photos, "--probe", probe)[0] == 0
        assert finished.items() <= times(tmp_path / "out").items()
        assert names(tmp_path / "out") == {"holed", "paint", "satin"}

    def test_a_disk_that_is_full_ends_it(
        self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(_batch, "write_table", full)
        status, _, errors = fit(photos, "--probe", probe)
        assert (status, len([line for line in errors if "error:" in line])) == (2, 1)
        assert "it is full" in errors[-1]
        assert not (tmp_path / "out").exists()


class TestWithoutReport:
    def test_nothing_of_an_earlier_run_stays_beside_it(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        """But what is the user's own."""
        out = tmp_path / "out"
        out.mkdir()
        for name in ("report.html", "brdf_std.binary", "alignment.json", "aligned_probe.exr", "mine.txt"):
            (out / name).touch()
        _, lines, _ = fit(photos / "paint.exr", "--probe", probe)
        assert names(out) == FILES | {"mine.txt"}
        assert lines[-1] == f"wrote {out}/brdf.binary, weights.json and fitted.exr"

    def test_its_doubts_are_said(self, fit: Fit, photos: Path, probe: Path, photographs: dict[str, Tensor]):
        tb.write_image(photos / "bright.exr", 9 * photographs["paint"])
        _, _, errors = fit(photos / "bright.exr", "--probe", probe)
        assert any("no material does. The photograph and the light probe are in different units" in e for e in errors)


@pytest.fixture
def reports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages that hold their title, all with one doubt and a note: the whole report takes longer than all the rest."""

    def write(path: Path, _: object, settings: dict[str, str], **__: object) -> Verdict:
        path.write_text(settings["title"])
        doubts = [Doubt("oscillation", "The weights oscillate."), Doubt("clamped", "3% came out negative.")]
        return Verdict(GRADES["Fair"], doubts)

    monkeypatch.setattr("torchbrdf.commands._results.write_report", write)


@pytest.mark.usefixtures("reports")
class TestReports:
    def test_each_has_its_own_and_its_warnings(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        given = [photos / "paint.exr", photos / "satin.exr"]
        notes = [f"{path}: 3% came out negative." for path in given]
        for when in ("made", "finished before"):
            status, lines, errors = fit(*given, "--probe", probe, "--report")
            assert (status, errors) == (0, [f"torchbrdf: warning: {path}: The weights oscillate." for path in given])
            assert lines[-2:] == [f"note: {text}" for text in notes]
            if when == "made":
                judged = "fair: pictures of it under other light are expected to be off by less than 15%"
                assert [line.split("; ")[-1] for line in lines[:2]] == [judged] * 2
        for path in given:
            folder = tmp_path / "out" / path.stem
            assert names(folder) == FILES | {"report.html"}
            assert (folder / "report.html").read_text() == path.name
            record = json.loads((folder / "weights.json").read_text())
            assert record["warnings"] == [f"{path}: The weights oscillate."]
            assert record["notes"] == [f"{path}: 3% came out negative."]

    def test_one_for_each_photograph_of_a_material(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        """What is said of both is said once."""
        given = [photos / "paint.exr", photos / "satin.exr"]
        _, lines, errors = fit(*given, "--same-material", "--probe", probe, "--report")
        assert [line for line in errors if "oscillate" in line] == ["torchbrdf: warning: The weights oscillate."]
        assert [line for line in lines if "negative" in line] == ["note: 3% came out negative."]
        out = tmp_path / "out"
        assert {path.stem: path.read_text() for path in out.glob("*.html")} == {
            "report_paint": "paint.exr", "report_satin": "satin.exr"
        }  # fmt: skip


class TestInputsInTheOutput:
    """A result takes the place of an earlier one, whose files go."""

    @pytest.mark.parametrize("how", ["one", "batch", "together", "photograph", "library"])
    def test_are_refused_and_stay(
        self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, precomputed_directory: Path, how: str
    ):
        out = tmp_path / "out"
        folder = out / "paint" if how == "batch" else out
        folder.mkdir(parents=True)
        kept = folder / {"photograph": "fitted.exr", "library": "brdf.binary"}.get(how, "aligned_probe.exr")
        source = {"photograph": photos / "paint.exr", "library": next(precomputed_directory.glob("*.binary"))}
        shutil.copy(source.get(how, probe), kept)
        given, options = [photos / "paint.exr"], ["--probe", kept]
        if how in ("batch", "together"):
            given.append(photos / "satin.exr")
        if how == "together":
            options.append("--same-material")
        if how == "photograph":
            given, options = [kept], ["--probe", probe]
        if how == "library":
            options = ["--probe", probe, "--library", out]
        before = kept.read_bytes()
        status, _, errors = fit(*given, *options)
        said = f"{kept}: an input, which a result in this folder replaces or removes; give another -o"
        assert (status, errors) == (2, [f"torchbrdf: error: {said}"])
        assert kept.read_bytes() == before
        assert [path for path in out.rglob("*") if path.is_file()] == [kept]


    @pytest.mark.parametrize("name", ["fit", "default", "auto"])
    def test_a_folder_called_as_a_word_of_the_command_is_none(
        self, fit: Fit, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
    ):
        monkeypatch.chdir(tmp_path)
        for _ in range(2):
            status, _, errors = fit(photos / "paint.exr", "--probe", "default", out=Path(name))
            assert (status, [line for line in errors if "error" in line]) == (0, [])


class TestSameMaterial:
    @pytest.mark.parametrize("options", [(), ("--robust",)])
    def test_is_what_the_estimator_makes_of_both(
        self, fit: Fit, photos: Path, probe: Path, tmp_path: Path, photographs: dict[str, Tensor], options: tuple[str]
    ):
        """The same ball twice, the second time brighter under a brighter light."""
        tb.write_image(photos / "again.exr", 2 * photographs["paint"])
        tb.LightProbe.default(64).scaled(2).save(tmp_path / "bright.exr")
        status, lines, _ = fit(
            photos / "paint.exr", photos / "again.exr", "--same-material",
            "--probe", probe, "--probe", tmp_path / "bright.exr", *options,
        )  # fmt: skip
        assert status == 0
        out = tmp_path / "out"
        assert names(out) == {"brdf.binary", "weights.json", "fitted_paint.exr", "fitted_again.exr"}
        assert lines[-1] == f"wrote {out}/brdf.binary, weights.json, fitted_paint.exr and fitted_again.exr"
        one, other = (tb.read_image(out / f"fitted_{name}.exr") for name in ("paint", "again"))
        torch.testing.assert_close(other, 2 * one, rtol=5e-3, atol=1e-3)  # half floats
        views = json.loads((out / "weights.json").read_text())["photographs"]
        assert [view["name"] for view in views] == ["paint", "again"]
        assert max(view["relative_error"] for view in views) < 0.05

    def test_a_photograph_that_does_not_fit_is_named(
        self, fit: Fit, photos: Path, probe: Path, photographs: dict[str, Tensor]
    ):
        tb.write_image(photos / "lit.exr", photographs["paint"].flip(-1) * torch.tensor([3.0, 1.0, 0.3])[:, None, None])
        _, _, errors = fit(photos / "paint.exr", photos / "lit.exr", "--same-material", "--probe", probe)
        unexplained = [line.split(": ")[2] for line in errors if "unexplained" in line]
        assert str(photos / "lit.exr") in unexplained

    def test_files_of_photographs_go_with_the_next_run(self, fit: Fit, photos: Path, probe: Path, tmp_path: Path):
        fit(photos / "paint.exr", photos / "satin.exr", "--same-material", "--probe", probe)
        fit(photos / "paint.exr", "--same-material", "--probe", probe)
        assert names(tmp_path / "out") == FILES
