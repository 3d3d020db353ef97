"""What every command and script says when something is wrong."""

import argparse
import contextlib
import io
import re
import signal
from pathlib import Path
from typing import Literal

import pytest

from torchbrdf.command_line import BadUsageError, Parser, exit_status, in_colour, say
from torchbrdf.files import writing
from torchbrdf.mitsuba_startup import MitsubaUnavailableError

ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.mark.parametrize(
    ("outcome", "status", "said"),
    [
        (None, 0, ""),
        (3, 3, ""),
        (ValueError("no such light"), 2, "bake: error: no such light\n"),
        (FileNotFoundError("a.exr: no such file"), 2, "bake: error: a.exr: no such file\n"),
        (MitsubaUnavailableError("no LLVM"), 2, "bake: error: no LLVM\n"),
        (
            RuntimeError("[enforce fail at alloc_cpu.cpp:117] DefaultCPUAllocator: can't allocate memory: you tried"),
            2,
            "bake: error: not enough memory for that: ask for fewer pixels, samples or materials\n",
        ),
        (KeyboardInterrupt(), 130, "bake: run it again\n"),
    ],
)
def test_a_script_ends_with_a_status_and_one_line(
    outcome: BaseException | int | None, status: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(options: argparse.Namespace) -> int | None:
        assert options.size == 4
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    options = argparse.Namespace(size=4)
    assert exit_status("bake", run, options, "run it again") == status
    assert capsys.readouterr().err == said


def test_a_script_without_such_a_message_ends_in_silence(capsys: pytest.CaptureFixture[str]) -> None:
    def run(_: argparse.Namespace) -> None:
        raise KeyboardInterrupt

    assert exit_status("bake", run, argparse.Namespace()) == 130
    assert capsys.readouterr().err == ""


class TestSignals:
    """Sent to this process; `tests/test_interruption.py` sends them to a command."""

    @staticmethod
    def received(number: signal.Signals, capsys: pytest.CaptureFixture[str], then: Exception | None = None) -> str:
        """What is said after a signal, which something on the way may turn into another error, or swallow."""

        def run(_: argparse.Namespace) -> None:
            try:
                signal.raise_signal(number)
            except KeyboardInterrupt:
                if then is None:
                    raise
                raise then from None

        assert exit_status("bake", run, argparse.Namespace(), "interrupted; nothing is lost") == 128 + number
        return capsys.readouterr().err

    @pytest.mark.parametrize("number", ENDING)
    def test_one_line_and_the_status_of_the_signal(self, number: signal.Signals, capsys: pytest.CaptureFixture[str]):
        named = "" if number == signal.SIGINT else f" ({number.name})"
        assert self.received(number, capsys) == f"bake: interrupted; nothing is lost{named}\n"

    @pytest.mark.parametrize("number", ENDING)
    def test_an_error_that_the_signal_became(self, number: signal.Signals, capsys: pytest.CaptureFixture[str]):
        """As where it comes in a callback from C, or to the processes of a sweep, too."""
        said = self.received(number, capsys, RuntimeError("a callback failed"))
        assert said.startswith("bake: interrupted; nothing is lost")

    def test_a_signal_that_the_program_ends_by(self, capsys: pytest.CaptureFixture[str]):
        """A server ends without an error."""

        def run(_: argparse.Namespace) -> None:
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)

        assert exit_status("live", run, argparse.Namespace()) == 143
        assert capsys.readouterr().err == "live: ended (SIGTERM)\n"

    def test_what_its_clean_up_did_not_reach_is_removed(self, tmp_path: Path):
        """A second signal may cut in where nothing holds it back; what the caller writes is the caller's."""

        def run(_: argparse.Namespace) -> None:
            left = writing(tmp_path / "x.binary")
            left.__enter__()
            others.append(left)
            signal.raise_signal(signal.SIGTERM)

        others: list[object] = []
        with writing(tmp_path / "mine") as mine:
            assert exit_status("bake", run, argparse.Namespace()) == 143
            assert list(tmp_path.iterdir()) == [mine]


def test_other_errors_of_a_script_keep_their_traceback() -> None:
    def run(_: argparse.Namespace) -> None:
        raise ImportError("No module named 'mitsuba.typo'")

    with pytest.raises(ImportError, match=r"mitsuba\.typo"):
        exit_status("bake", run, argparse.Namespace())


def test_options_that_are_wrong_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser(prog="bake")
    parser.add_argument("--size", type=int)
    with pytest.raises(BadUsageError) as left:
        parser.parse_args(["--size", "much"])
    assert left.value.code == 2
    assert left.value.message == "argument --size: invalid int value: 'much'; see `bake --help`"
    assert capsys.readouterr().err == "bake: error: argument --size: invalid int value: 'much'; see `bake --help`\n"


class TestMisspelt:
    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (["bkae"], "argument COMMAND: invalid choice: 'bkae' (did you mean bake?); see `kiln --help`"),
            (["Bake"], "argument COMMAND: invalid choice: 'Bake' (did you mean bake?); see `kiln --help`"),
            (["sing"], "argument COMMAND: invalid choice: 'sing' (choose from"),
            (["--hlep"], "unrecognized arguments: --hlep (did you mean --help?); see `kiln --help`"),
            (["bake", "--sise", "4"], "unrecognized arguments: --sise (did you mean --size?); see `kiln bake --help`"),
            (["bake", "x", "--sise=4"], "unrecognized arguments: --sise (did you mean --size?); see `kiln bake"),
            (["bake", "x", "--colour"], "unrecognized arguments: --colour; see `kiln bake --help`"),
            (["bake", "x", "-q"], "unrecognized arguments: -q; see `kiln bake --help`"),
            (["bake", "x", "y"], "unrecognized arguments: y; see `kiln bake --help`"),
            (["bake", "x", "--kind", "claay"], "argument --kind: invalid choice: 'claay' (did you mean clay?); see"),
            (
                ["bake", "x", "--gla", "salt"],
                "ambiguous option: --gla (did you mean --glaze?); it could be --glaze, --glaze-tint; see `kiln bake",
            ),
            (["bake", "x", "--gl=1"], "ambiguous option: --gl; it could be --glaze, --glaze-tint, --gloss; see `kiln"),
            (["bake", "x", "--kind", "wood"], "argument --kind: invalid choice: 'wood' (choose from"),
        ],
    )
    def test_is_told_the_nearest_and_where_help_is(self, words: list[str], said: str, capsys) -> None:
        with pytest.raises(BadUsageError) as left:
            self.parser().parse_args(words)
        assert left.value.code == 2
        assert left.value.message.startswith(said)
        assert capsys.readouterr().err == f"kiln: error: {left.value.message}\n"

    def test_what_is_right_passes(self) -> None:
        """Abbreviated, with values behind them, numbers below 0, and words after --."""
        words = ["bake", "--siz", "-2", "-oresult", "--kind=clay", "--", "--sise"]
        options = self.parser().parse_args(words)
        assert (options.size, options.output, options.kind, options.of) == (-2, "result", "clay", "--sise")

    @staticmethod
    def parser() -> Parser:
        whole = Parser(prog="kiln")
        bake = whole.add_subparsers(metavar="COMMAND").add_parser("bake")
        bake.add_argument("of")
        bake.add_argument("--size", type=float)
        bake.add_argument("--kind", choices=["clay", "glass"])
        bake.add_argument("-o", "--output")
        for name in ("--glaze", "--glaze-tint", "--gloss"):
            bake.add_argument(name)
        return whole


def test_a_file_is_named_before_what_is_wrong_with_it(capsys: pytest.CaptureFixture[str]) -> None:
    def run(options: argparse.Namespace) -> None:
        open("/nowhere/at/all")  # noqa: SIM115

    assert exit_status("bake", run, argparse.Namespace()) == 2
    assert capsys.readouterr().err == "bake: error: /nowhere/at/all: No such file or directory\n"


def test_an_interruption_that_speaks_is_heard(capsys: pytest.CaptureFixture[str]) -> None:
    def run(options: argparse.Namespace) -> None:
        raise KeyboardInterrupt("half is done;\n  go on")

    assert exit_status("bake", run, argparse.Namespace(), interrupted="nothing was written") == 130
    assert capsys.readouterr().err == "bake: half is done; go on\n"


@pytest.mark.parametrize(
    ("outcome", "told"),
    [
        (ValueError("no such light"), ["no such light"]),
        (ValueError(""), [""]),
        (KeyboardInterrupt("half is done"), ["half is done"]),
        (KeyboardInterrupt(), ["run it again"]),
        (None, []),
    ],
)
def test_what_is_said_of_an_end_is_told(outcome: BaseException | None, told: list[str]) -> None:
    def run(_: argparse.Namespace) -> None:
        if outcome is not None:
            raise outcome

    heard: list[str] = []
    exit_status("bake", run, argparse.Namespace(), "run it again", told=heard.append)
    assert heard == told


def test_paragraphs_of_help_stay_apart_and_examples_as_they_are() -> None:
    long = "word " * 30
    example = "for example:\n    bake  --size   4 " + "x" * 90
    text = Parser(prog="bake", description=f"First.\n\n{long}\n\nLast.", epilog=example).format_help()
    first, wrapped, last = text.split("\n\n")[1:4]
    assert (first, last) == ("First.", "Last.")
    assert wrapped.split() == long.split()
    assert len(wrapped.splitlines()) > 1
    assert example in text


class TestColours:
    """On terminals alone, which pytest's streams are none of."""

    @pytest.fixture(autouse=True)
    def plain_environment(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for name in ("NO_COLOR", "FORCE_COLOR"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.setattr("os.name", "posix")

    @pytest.mark.parametrize(
        ("terminal", "environment", "coloured"),
        [
            (True, {}, True),
            (False, {}, False),
            (True, {"NO_COLOR": "1"}, False),
            (True, {"NO_COLOR": ""}, True),
            (True, {"TERM": "dumb"}, False),
            (False, {"FORCE_COLOR": "1"}, True),
            (True, {"FORCE_COLOR": "1", "TERM": "dumb"}, True),
            (True, {"FORCE_COLOR": "1", "NO_COLOR": "1"}, False),
            (False, {"FORCE_COLOR": ""}, False),
        ],
    )
    def test_where(
        self, terminal: bool, environment: dict[str, str], coloured: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        class Stream(io.StringIO):
            def isatty(self) -> bool:
                return terminal

        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        assert in_colour(Stream()) == coloured

    @pytest.mark.parametrize("label", ["error", "warning"])
    def test_only_the_label_is_coloured(
        self, label: Literal["error", "warning"], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        say("bake", "too  bright", label)
        plain = capsys.readouterr().err
        monkeypatch.setenv("FORCE_COLOR", "1")
        say("bake", "too  bright", label)
        coloured = capsys.readouterr().err
        assert plain == f"bake: {label}: too bright\n"
        assert re.sub(r"\x1b\[[\d;]*m", "", coloured) == plain
        assert re.fullmatch(rf"bake: \x1b\[[\d;]+m{label}:\x1b\[0m too bright\n", coloured)

    def test_what_is_no_error_stays_plain(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setenv("FORCE_COLOR", "1")
        say("bake", "interrupted; nothing was written")
        assert capsys.readouterr().err == "bake: interrupted; nothing was written\n"
