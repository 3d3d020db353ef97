"""What every command and script says when something is wrong."""

import argparse

import pytest

from torchbrdf.command_line import Parser, exit_status
from torchbrdf.mitsuba_startup import MitsubaUnavailableError


@pytest.mark.parametrize(
    ("outcome", "status", "said"),
    [
        (None, 0, ""),
        (3, 3, ""),
        (ValueError("no such light"), 2, "bake: error: no such light\n"),
        (FileNotFoundError("a.exr: no such file"), 2, "bake: error: a.exr: no such file\n"),
        (MitsubaUnavailableError("no LLVM"), 2, "bake: error: no LLVM\n"),
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


def test_other_errors_of_a_script_keep_their_traceback() -> None:
    def run(_: argparse.Namespace) -> None:
        raise ImportError("No module named 'mitsuba.typo'")

    with pytest.raises(ImportError, match=r"mitsuba\.typo"):
        exit_status("bake", run, argparse.Namespace())


def test_options_that_are_wrong_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser(prog="bake")
    parser.add_argument("--size", type=int)
    with pytest.raises(SystemExit) as left:
        parser.parse_args(["--size", "much"])
    assert left.value.code == 2
    assert capsys.readouterr().err == "bake: error: argument --size: invalid int value: 'much'; see `bake --help`\n"


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
