"""A thousand mutated files a reader; and whether the watch sees readers that misbehave."""

import multiprocessing.forkserver
import sys
import zlib
from argparse import Namespace
from pathlib import Path
from random import Random

import pytest

import fuzz_readers as script
import planted_readers
import torchbrdf.light.probe
from fuzzing.campaign import Finding
from fuzzing.files import InputFile
from fuzzing.formats import openexr, png
from fuzzing.mutations import mutated, mutated_json
from fuzzing.readers import READERS
from fuzzing.reading import CONSTANT, Problem
from fuzzing.worker import Share
from torchbrdf.command_line import INTERRUPTED

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="workers are watched through /proc")


@pytest.fixture
def options(tmp_path: Path) -> Namespace:
    found = script.parser().parse_args(["--quiet", "--inputs", "12", "--patience", "0.4"])
    found.source, found.output = "planted_readers", tmp_path / "findings"
    return found


def bad_inputs(name: str, count: int, seed: int = 0) -> list[int]:
    reader = planted_readers.READERS[name]
    return [i for i in range(count) if reader.input(reader.seeds(), seed, i)[0].content == b"bad"]


@pytest.mark.parametrize("name", READERS)
def test_a_thousand_mutated_files(name: str, tmp_path: Path, capsys: pytest.CaptureFixture):
    options = script.parser().parse_args(["--quiet", "--reader", name, "--inputs", "1000", "--output", str(tmp_path)])
    status = script.fuzz(options)
    assert status == 0, capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("aborts", "crash"),
        ("leaves", "crash"),
        ("hangs", "hang"),
        ("allocates", "memory"),
        ("allocates_and_says_so", "memory"),
        ("raises", "exception"),
        ("exits", "exception"),
        ("names_no_file", "message"),
        ("says_two_lines", "message"),
        ("colours_the_terminal", "message"),
    ],
)
def test_planted_faults_are_found_and_saved(name: str, kind: str, options: Namespace, capsys: pytest.CaptureFixture):
    options.reader, options.inputs = [name], 6 if kind == "hang" else 12
    if kind != "hang":
        options.patience = script.PATIENCE  # a busy machine takes longer over an input than over a hang here
    assert script.fuzz(options) == script.FOUND
    bad = bad_inputs(name, options.inputs)
    assert len(bad) >= 2
    printed = capsys.readouterr().out
    assert f"{name}: {kind}, {len(bad)} inputs" in printed
    assert f"| {options.inputs} |" in printed, "those that took a worker along count"
    if kind in ("hang", "crash") and name != "leaves":
        assert "planted_readers.py:" in printed
    saved = sorted(options.output.iterdir())
    assert {path.name for path in saved} == {f"{name}-0-{i}.txt" for i in bad[:3]}
    assert {path.read_bytes() for path in saved} == {b"bad"}
    assert f"--reader {name} --seed 0 --first {bad[0]} --inputs 1" in printed


def test_readers_may_name_another_constant(options: Namespace):
    assert READERS["exr"].constant("LightProbe.open") > READERS["exr"].constant("read_image") == CONSTANT
    options.reader = ["is_modest_with_less"]
    assert script.fuzz(options) == script.FOUND


@pytest.mark.parametrize("name", ["loads_once", "is_modest", "refuses", "does_not_find"])
def test_sound_readers_pass(name: str, options: Namespace, capsys: pytest.CaptureFixture):
    options.reader, options.inputs = [name], 50
    options.patience = script.PATIENCE  # a busy machine takes longer over what one loads than over a hang here
    assert script.fuzz(options) == 0, capsys.readouterr().out
    assert not options.output.exists()


def test_workers_read_with_the_package_of_the_watcher(
    options: Namespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    """Whatever lies in the current folder."""
    for module in ("__init__", "light/__init__", "light/probe"):
        path = tmp_path / "torchbrdf" / f"{module}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    monkeypatch.chdir(tmp_path)
    multiprocessing.forkserver._forkserver._stop()
    options.reader = ["says_which_package"]
    script.fuzz(options)
    assert f"TypeError: {torchbrdf.light.probe.__file__}" in capsys.readouterr().out


def test_a_saved_finding_is_found_again(options: Namespace, capsys: pytest.CaptureFixture):
    options.reader = ["raises"]
    script.fuzz(options)
    options.files = sorted(options.output.iterdir())
    capsys.readouterr()
    assert script.fuzz(options) == script.FOUND
    printed = capsys.readouterr().out
    assert f"raises: exception, {len(options.files)} inputs" in printed
    assert f"{options.files[0]}: 3 bytes" in printed


def test_a_file_of_no_reader_is_refused(options: Namespace, tmp_path: Path):
    (tmp_path / "a.doc").write_bytes(b"bad")
    options.reader, options.files = ["raises"], [tmp_path / "a.doc"]
    with pytest.raises(ValueError, match=r"a\.doc: no reader takes such a file; those chosen are raises$"):
        script.fuzz(options)


def test_pieces_and_several_processes_find_the_same(options: Namespace, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(script, "_SHARE", 5)
    options.reader, options.inputs, options.first, options.processes = ["raises"], 40, 8, 2
    script.fuzz(options)
    expected = [i for i in bad_inputs("raises", 48) if i >= 8][:3]
    assert {path.name for path in options.output.iterdir()} == {f"raises-0-{i}.txt" for i in expected}


def test_findings_are_saved_in_order_whoever_found_them_first(options: Namespace, capsys: pytest.CaptureFixture):
    share = Share("planted_readers", "raises", planted_readers.SEEDS, 0, 0, 50)
    problem = Problem("exception", "here", "no")
    script._print_findings([Finding(share, index, problem) for index in (40, 9, 24, 18, 12)], options)
    assert {path.name for path in options.output.iterdir()} == {f"raises-0-{i}.txt" for i in (9, 12, 18)}


def test_seeds_and_numbers_choose_the_files():
    reader = READERS["exr"]
    seeds = reader.seeds()
    first = [reader.input(seeds, 0, i) for i in range(20)]
    assert first == [reader.input(seeds, 0, i) for i in range(20)]
    assert first != [reader.input(seeds, 1, i) for i in range(20)]
    assert len({file.content for file, _ in first}) == 20


def test_interrupted_it_prints_the_table(
    options: Namespace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(script.tqdm, "update", interrupted)
    options.reader = ["refuses"]
    assert script.exit_status("fuzz", script.fuzz, options, "interrupted") == INTERRUPTED
    assert "| refuses |" in capsys.readouterr().out


@pytest.mark.parametrize("wrong", [("--inputs", "0"), ("--first", "-1"), ("--processes", "0")])
def test_numbers_out_of_range(wrong: tuple[str, str]):
    with pytest.raises(ValueError, match="--inputs and --processes must be at least 1, and --first at least 0"):
        script.fuzz(script.parser().parse_args(["--quiet", *wrong]))


class TestMutations:
    def test_most_chunks_of_png_keep_sound_checksums(self):
        content = png.seeds()[0].content
        files = [png.mutated(content, Random(i), [content]) for i in range(200)]
        assert 170 < sum(png._encoded(png._parsed(file)) == file for file in files) < 200

    def test_offsets_of_exr_follow_a_longer_header(self):
        content = next(seed.content for seed in openexr.seeds() if seed.name == "ZIP lines")
        version, headers, end = openexr._parsed(content)
        assert openexr._encoded(version, headers) == content[:end]
        headers[0].append((b"note", b"string", b"longer"))
        longer = openexr._encoded(version, headers)
        body = openexr._moved_offsets(content[end:], end, len(longer) - end)
        first = int.from_bytes(body[:8], "little")
        moved = int.from_bytes(content[end : end + 8], "little")
        assert (longer + body)[first : first + 8] == content[moved : moved + 8]

    def test_json_stays_json(self):
        assert all(mutated_json(b'{"a": [1, {"b": "c"}], "d": 2}', Random(i)) for i in range(300))

    def test_what_does_not_apply_becomes_a_change_of_bytes(self):
        def never(*_: object) -> bytes:
            raise ValueError

        assert sum(mutated(b"abcdef", Random(i), [b"xyz"], never) != b"abcdef" for i in range(50)) > 40

    def test_a_hole_follows_the_content(self, tmp_path: Path):
        InputFile("sparse", ".binary", b"ab", 10, ((6, b"cd"),)).write(tmp_path / "file")
        assert (tmp_path / "file").read_bytes() == b"ab\0\0\0\0cd\0\0"
        InputFile("cut", ".binary", b"abcd", 2).write(tmp_path / "file")
        assert (tmp_path / "file").read_bytes() == b"ab"

    def test_sums_of_png_are_those_of_zlib(self):
        chunk = png._encoded([(b"IDAT", b"x")])[8:]
        assert chunk[-4:] == zlib.crc32(b"IDATx").to_bytes(4, "big")
