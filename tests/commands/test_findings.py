"""What a command tells, to people and to scripts: the same mechanism for all."""

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import torchbrdf as tb
from torchbrdf import __version__
from torchbrdf.cli import main
from torchbrdf.commands import Findings
from torchbrdf.progress import progress_bar

EVERYWHERE = ("command", "version", "status", "error", "warnings", "notes", "files")


def document(capsys: pytest.CaptureFixture[str], *words: object, status: int = 0) -> dict:
    """What a command prints with --json: that alone, as strict JSON."""
    assert main([*map(str, words), "--json"]) == status
    told = json.loads(capsys.readouterr().out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert tuple(told)[: len(EVERYWHERE)] == EVERYWHERE
    assert (told["command"], told["version"], told["status"]) == (words[0], __version__, status)
    assert (told["error"] is None) == (status in (0, 3))
    assert all(Path(path).is_file() for path in told["files"])
    return told


class TestWays:
    @pytest.fixture
    def told(self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
        monkeypatch.setattr("torchbrdf.progress._draws", lambda _: True)

        def run(quiet: bool, as_json: bool) -> tuple[str, str]:
            findings = Findings("fit", quiet, as_json)
            with findings.gathered():
                findings.line("a line")
                print("of a library")
                list(progress_bar([1], desc="bar", mininterval=0))
                findings.add(number=1.5)
            findings.finish(0)
            captured = capsys.readouterr()
            return captured.out, captured.err

        return run

    def test_for_people(self, told):
        out, err = told(quiet=False, as_json=False)
        assert out == "a line\nof a library\n"
        assert "bar" in err

    def test_quiet_prints_no_line_and_no_bar(self, told):
        assert told(quiet=True, as_json=False) == ("of a library\n", "")

    def test_json_has_standard_output_to_itself(self, told):
        out, err = told(quiet=False, as_json=True)
        assert json.loads(out)["number"] == 1.5
        assert err.startswith("of a library\n")
        assert "bar" in err

    def test_quiet_json_shows_no_bar(self, told):
        out, err = told(quiet=True, as_json=True)
        assert json.loads(out)["number"] == 1.5
        assert err == "of a library\n"

    def test_standard_output_is_back_after_an_error(self):
        before = sys.stdout
        with pytest.raises(ValueError, match="bad"), Findings("fit", as_json=True).gathered():
            raise ValueError("bad")
        assert sys.stdout is before


CLOSED, FULL = "a pipe that is closed", "/dev/full"
FULL_LINE = (
    "torchbrdf: error: standard output: cannot be written (No space left on device); files that were written stay\n"
)


@pytest.mark.parametrize(
    ("where", "status", "said"),
    [
        (CLOSED, 0, ""),
        pytest.param(FULL, 2, FULL_LINE, marks=pytest.mark.skipif(not Path(FULL).exists(), reason="no /dev/full here")),
    ],
)
class TestStandardOutputThatTakesNothing:
    """A reader that had enough is no error; a full disk is one, after the work."""

    @pytest.fixture
    def stdout(self, where: str) -> Iterator[io.TextIOWrapper]:
        if where == CLOSED:
            reading, writing = os.pipe()
            os.close(reading)
        else:
            writing = os.open(where, os.O_WRONLY)
        stream = os.fdopen(writing, "w")
        yield stream
        with contextlib.suppress(OSError):
            stream.close()

    @pytest.mark.parametrize("options", [(), ("--json",), ("--quiet", "--json")])
    def test_what_was_computed_stays(self, stdout, status, said, options, tmp_path, monkeypatch, capsys):
        tb.write_image(tmp_path / "a.exr", torch.ones(3, 4, 8))
        monkeypatch.setattr(sys, "stdout", stdout)
        assert main(["convert", str(tmp_path / "a.exr"), str(tmp_path / "b.exr"), *options]) == status
        assert torch.equal(tb.read_image(tmp_path / "b.exr"), torch.ones(3, 4, 8))
        assert capsys.readouterr().err == said

    def test_a_line_that_is_waited_for_does_not_end_the_work(self, stdout, status, said, monkeypatch):
        monkeypatch.setattr(sys, "stdout", stdout)
        findings = Findings("fit")
        findings.line("one", at_once=True)
        findings.line("another", at_once=True)
        error = findings.finish(0)
        assert (error is None) == (status == 0)

    @pytest.mark.parametrize("words", [["--version"], ["fit", "--help"], ["completion", "bash"]])
    def test_nothing_is_said_when_python_ends(self, stdout, status, said, words):
        command = [sys.executable, "-m", "torchbrdf", *words]
        done = subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)
        assert (done.returncode, done.stderr) == (status, said)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
@pytest.mark.parametrize("name", ["ball °球", "r\udce9"])
def test_characters_that_standard_output_lacks_are_escaped(encoding, name, tmp_path, monkeypatch):
    tb.write_image(tmp_path / "a.hdr", torch.ones(3, 4, 8))
    kept = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(kept, encoding))
    assert main(["convert", str(tmp_path / "a.hdr"), str(tmp_path / f"{name}.hdr")]) == 0
    assert f"{name}.hdr".encode(encoding, "backslashreplace") in kept.getvalue()
    sys.stdout.detach()


def test_a_way_to_write_what_is_no_text_stays(monkeypatch):
    """As Python has it in the locale C: names of files come out as the bytes that they are."""
    kept = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(kept, "utf-8", errors="surrogateescape"))
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["--version"])
    assert sys.stdout.errors == "surrogateescape"


def test_the_document_holds_json_alone():
    """Numbers that are not finite are null, wherever they are."""
    findings = Findings("fit")
    findings.add(
        tensor=torch.tensor([[1.0, float("nan")]]),
        array=np.array([float("inf"), 2]),
        number=-float("inf"),
        scalar=torch.tensor(True),
        path=Path("a") / "b",
        within={"tuple": (1, None, "x"), 3: [float("nan")]},
    )
    found = findings.document(0)
    assert {key: found[key] for key in found if key not in EVERYWHERE} == {
        "tensor": [[1.0, None]],
        "array": [None, 2.0],
        "number": None,
        "scalar": True,
        "path": "a/b",
        "within": {"tuple": [1, None, "x"], "3": [None]},
    }
    json.dumps(found, allow_nan=False)


@pytest.fixture(scope="module")
def uniform() -> tb.MerlTable:
    """0.1 / sr."""
    return tb.MerlTable.from_function(lambda w_i, w_o: torch.full_like(w_i, 0.1))


def brighter(table: tb.MerlTable, times: float, path: Path) -> Path:
    replace(table, values=times * table.values).save(path)
    return path


@pytest.fixture
def grey(uniform: tb.MerlTable, tmp_path: Path) -> Path:
    uniform.save(tmp_path / "grey.binary")
    return tmp_path / "grey.binary"


@pytest.fixture
def white(tmp_path: Path) -> Path:
    tb.write_image(tmp_path / "white.exr", torch.ones(3, 8, 16))
    return tmp_path / "white.exr"


class TestCommands:
    def test_render(self, capsys, tmp_path, grey, white):
        small = "--size", 8, "--samples", 64
        told = document(capsys, "render", grey, "--probe", white, *small, "-o", tmp_path / "x.exr")
        assert told["files"] == [str(tmp_path / "x.exr")]

    def test_verify(self, capsys, tmp_path, grey):
        (tmp_path / "nylon.binary").write_bytes(b"short")
        told = document(capsys, "verify", tmp_path, status=2)
        assert told["error"] == "1 unsound: nylon"
        assert "not a MERL table" in told["unsound"]["nylon"]
        (table,) = told["tables"]
        assert (table["name"], table["kind"]) == ("grey", "MERL")
        assert table["least"] == pytest.approx(0.1)
        assert np.shape(table["albedo"]) == (4, 3)
        assert told["missing"] is None

    def test_strict_has_a_status_and_no_error(self, capsys, tmp_path, uniform):
        brighter(uniform, 90, tmp_path / "lamp.binary")
        told = document(capsys, "verify", tmp_path, "--strict", status=3)
        assert len(told["warnings"]) == 1
        assert told["warnings"][0].startswith("lamp: ")

    def test_classes(self, capsys, merl_directory):
        told = document(capsys, "classes", "--library", merl_directory, "--n-classes", 2)
        names = {path.stem for path in merl_directory.iterdir()}
        assert set(told["classes_of_materials"]) == names
        assert sum(told["sizes"]) == 3 * len(names)
        channels = [j for of_one in told["classes_of_materials"].values() for j in of_one]
        assert [channels.count(j) for j in range(len(told["sizes"]))] == told["sizes"]

    def test_convert(self, capsys, tmp_path, grey):
        told = document(capsys, "convert", grey, tmp_path / "again.binary")
        assert told["files"] == [str(tmp_path / "again.binary")]
        assert max(told["differences"].values()) < 1e-6
        assert told["common"] == pytest.approx(1)

    def test_compare(self, capsys, tmp_path, grey, white, uniform):
        words = grey, brighter(uniform, 2, tmp_path / "bright.binary"), "--probe", white, "--size", 8, "--samples", 64
        told = document(capsys, "compare", *words, "-o", tmp_path / "page.html")
        (difference,) = told["differences"]
        assert (told["reference"], difference["name"]) == ("grey", "bright")
        assert difference["picture"] == pytest.approx(1, rel=0.05)
        assert difference["cells"]["l2"] == pytest.approx(1, rel=1e-4)
        assert told["files"] == [str(tmp_path / "page.html")]

    def test_analytic(self, capsys, tmp_path, grey):
        told = document(capsys, "analytic", grey, "--model", "lambert", "-o", tmp_path / "grey.xml")
        fit = told["fits"][0]
        assert (fit["model"], fit["converged"]) == ("lambert", True)
        assert fit["relative_error"] < 1e-3
        assert [value for name in fit["parameters"] for value in fit["parameters"][name]]
        assert told["files"] == [str(tmp_path / "grey.xml")]

    def test_merge(self, capsys, tmp_path):
        scene = torch.rand(3, 16, 16) + 0.1
        images = [tmp_path / f"{time}.exr" for time in (1, 2)]
        for time, path in enumerate(images, 1):
            tb.write_image(path, time * scene)
        told = document(capsys, "merge", *images, "--times", 1, 2, "--still", "-o", tmp_path / "merged.exr")
        assert told["about"]
        assert told["primaries"] == "rec709"

    def test_export(self, capsys, tmp_path, grey, white):
        told = document(capsys, "export", grey, "--probe", white, "--size", 8, "-o", tmp_path / "scene")
        assert {Path(path).name for path in told["files"]} == {path.name for path in (tmp_path / "scene").iterdir()}

    def test_quiet_prints_nothing(self, capsys, tmp_path, grey, white):
        words = "render", grey, "--probe", white, "--size", 8, "--samples", 64, "--quiet", "-o", tmp_path / "x.exr"
        assert main([*map(str, words)]) == 0
        assert capsys.readouterr() == ("", "")

    def test_quiet_keeps_warnings(self, capsys, tmp_path, uniform):
        brighter(uniform, 90, tmp_path / "lamp.binary")
        assert main(["verify", str(tmp_path), "--quiet"]) == 0
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.startswith("torchbrdf: warning: lamp: ")
        assert captured.err.count("\n") == 1


class TestErrors:
    def test_bad_input(self, capsys, tmp_path):
        gone = tmp_path / "gone.binary"
        assert main(["render", str(gone), "--probe", "default", "--json", "-o", str(tmp_path / "x.png")]) == 2
        captured = capsys.readouterr()
        told = json.loads(captured.out)
        assert captured.err == f"torchbrdf: error: {told['error']}\n"
        assert told["error"].startswith(f"{gone}: no such file")
        assert (told["status"], told["files"], told["warnings"]) == (2, [], [])

    @pytest.mark.parametrize(
        ("words", "command", "told"),
        [
            (["fit", "--json"], "fit", "the following arguments are required: PHOTO"),
            (["render", "--size", "much", "--json"], "render", "argument --size: must be a whole number"),
            (["verify", "--jso", "x", "--unknown"], "verify", "unrecognized arguments: --unknown"),
            (["paint", "--json"], None, "argument COMMAND: invalid choice: 'paint'"),
        ],
    )
    def test_bad_options(self, capsys, words, command, told):
        with pytest.raises(SystemExit, match="2"):
            main(words)
        captured = capsys.readouterr()
        found = json.loads(captured.out)
        assert (found["command"], found["status"]) == (command, 2)
        assert found["error"].startswith(told)
        assert captured.err == f"torchbrdf: error: {found['error']}\n"

    def test_bad_options_without_json(self, capsys):
        with pytest.raises(SystemExit, match="2"):
            main(["fit"])
        assert capsys.readouterr().out == ""

    def test_an_interruption(self, capsys, monkeypatch, tmp_path):
        def run(*_: object) -> int:
            raise KeyboardInterrupt

        monkeypatch.setattr("torchbrdf.commands.verify.run", run)
        run.__doc__ = "Verify."
        assert main(["verify", str(tmp_path), "--json"]) == 130
        told = json.loads(capsys.readouterr().out)
        assert (told["status"], told["error"]) == (130, "interrupted; nothing was written")
