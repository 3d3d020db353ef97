"""Every command shows an example in its help, which it takes."""

import shlex

import pytest

from torchbrdf import commands
from torchbrdf.cli import main, parser
from torchbrdf.commands.fit import check_options as check_fit
from torchbrdf.commands.probe import check_options as check_probe

EXAMPLES = [(name, line) for name, command in commands.found().items() for line in command.EXAMPLES]


def test_every_command_has_one():
    assert {name for name, _ in EXAMPLES} == set(commands.found())


@pytest.mark.parametrize(("name", "line"), EXAMPLES)
def test_it_is_taken(name: str, line: str):
    """By the parser, and by what is checked before a file is opened."""
    command = line.partition(">")[0].strip().removeprefix('eval "$(').removesuffix(')"')
    program, *words = shlex.split(command)
    assert (program, words[0]) == ("torchbrdf", name)
    options = parser().parse_args(words)
    assert options.command == name
    check = {"fit": check_fit, "probe": check_probe}.get(name)
    if check is not None:
        check(options)


@pytest.mark.parametrize("name", commands.found())
def test_the_help_shows_them_as_they_are(name: str, capsys: pytest.CaptureFixture[str], monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    with pytest.raises(SystemExit, match="0"):
        main([name, "--help"])
    last = capsys.readouterr().out.split("\n\n")[-1]
    assert last == "for example:\n" + "".join(f"    {line}\n" for line in commands.found()[name].EXAMPLES)
