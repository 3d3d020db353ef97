"""The page's commands, and what becomes of one that fails."""

from argparse import Namespace
from pathlib import Path

import pytest

import run_tutorial as script
from paths import ROOT


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "page.md"
    first, second = "$ echo 1 > one\n1\n$ false\n", "$ echo 2 > two\n"
    path.write_text(f"Text\n\n```console\n{first}```\n\n$ not here\n\n```console\n{second}```\n")
    return path


def test_commands_are_those_of_console_blocks(page: Path):
    assert script.commands_of(page) == ["echo 1 > one", "false", "echo 2 > two"]


def test_it_stops_where_a_command_fails(page: Path, tmp_path: Path):
    assert script.run(Namespace(page=page, output=tmp_path / "out")) == script.FAILED
    assert (tmp_path / "out" / "one").exists()
    assert not (tmp_path / "out" / "two").exists()
    assert (tmp_path / "out" / "scripts" / "run_tutorial.py").exists()


def test_a_page_without_commands_is_refused(tmp_path: Path):
    (tmp_path / "page.md").write_text("nothing")
    with pytest.raises(ValueError, match=r"page\.md: no command here"):
        script.commands_of(tmp_path / "page.md")


def test_the_tutorial_goes_the_whole_way():
    commands = " ".join(script.commands_of(ROOT / "docs" / "tutorial.md"))
    assert all(f"torchbrdf {name} " in commands for name in ("merge", "probe", "fit", "export"))
