"""Progress: bars on a terminal, lines elsewhere, where they are asked for, and none while they are hidden."""

import sys
from io import StringIO
from pathlib import Path
from threading import Event

import pytest

from torchbrdf.progress import _draws, above_bars, announce, no_progress, progress_bar, told_if_slow


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is captured is taken for one."""
    monkeypatch.setattr("torchbrdf.progress._draws", lambda _: True)


def counted(**settings: float) -> list[int]:
    return list(progress_bar([1, 2, 3], desc="materials", mininterval=0, **settings))


@pytest.mark.usefixtures("terminal")
@pytest.mark.parametrize("shown", [True, False])
def test_shown_where_it_is_asked_for(shown: bool, capsys: pytest.CaptureFixture[str]) -> None:
    assert counted(shown=shown) == [1, 2, 3]
    captured = capsys.readouterr()
    assert ("materials: 100%" in captured.err) == shown
    assert captured.out == ""


@pytest.mark.usefixtures("terminal")
def test_hidden_in_blocks_also_in_one_another(capsys: pytest.CaptureFixture[str]) -> None:
    with no_progress():
        with no_progress():
            assert counted() == [1, 2, 3]
        assert counted() == [1, 2, 3]
        announce("it takes long")
        assert capsys.readouterr().err == ""
    counted()
    assert "materials" in capsys.readouterr().err


@pytest.mark.usefixtures("terminal")
def test_shown_again_after_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="bad"), no_progress():
        raise ValueError("bad")
    counted()
    assert "materials" in capsys.readouterr().err


@pytest.mark.usefixtures("terminal")
def test_a_bar_makes_way_for_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    """It is cleared before the line, and drawn anew after it."""
    with progress_bar(total=2, desc="materials", mininterval=0) as bar:
        bar.update()
        capsys.readouterr()
        with above_bars():
            cleared = capsys.readouterr().err
            print("a line")
        assert set(cleared) <= set("\r ")
        assert "materials" in capsys.readouterr().err


def test_bars_are_for_terminals_and_notebooks(tmp_path: Path) -> None:
    terminal = type("Terminal", (StringIO,), {"isatty": lambda _: True})
    notebook = type("OutStream", (StringIO,), {"__module__": "ipykernel.iostream"})
    with open(tmp_path / "log", "w") as log:
        assert [_draws(stream) for stream in (terminal(), notebook(), log)] == [True, True, False]


class TestElsewhere:
    """Where stderr is a file or a pipe."""

    def test_what_is_quick_says_nothing(self, capsys: pytest.CaptureFixture[str]) -> None:
        """Nor does a line that is printed beside it."""
        with progress_bar(total=2, desc="materials") as bar:
            bar.update()
            with above_bars():
                print("a line", file=sys.stderr)
            bar.update()
        assert capsys.readouterr().err == "a line\n"

    def test_lines_that_a_log_can_hold(self, capsys: pytest.CaptureFixture[str]) -> None:
        """As they would come in half a minute."""
        counted(delay=0)
        said = capsys.readouterr().err
        assert "\r" not in said
        assert said.splitlines()[:2] == [
            "materials: 0 of 3 after 00:00, ? left",
            "materials: 1 of 3 after 00:00, 00:00 left",
        ]

    def test_the_count_is_never_old(self, capsys: pytest.CaptureFixture[str]) -> None:
        """Where quick items are followed by slow ones, as a library's groups of rings are."""
        now = 0.0
        bar = progress_bar(range(60), desc="groups")
        bar._time, bar.start_t, bar.last_print_t = lambda: now, 0.0, 0.0
        for i in bar:
            now += 1 if i < 40 else 20
        said = [line.split(" after ")[0] for line in capsys.readouterr().err.splitlines()]
        assert said[:4] == ["groups: 30 of 60", "groups: 41 of 60", "groups: 43 of 60", "groups: 45 of 60"]

    def test_one_in_another(self, capsys: pytest.CaptureFixture[str]) -> None:
        """No character moves a cursor that is not there."""
        for _ in progress_bar([1, 2], desc="photographs", mininterval=0, delay=0):
            counted(delay=0)
        said = capsys.readouterr().err
        assert {line.split(":")[0] for line in said.splitlines()} == {"photographs", "materials"}
        assert said.replace("\n", "").isprintable()

    @pytest.mark.parametrize("patience", [0.0, 60.0])
    def test_a_block_is_announced_where_it_takes_long(
        self, patience: float, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("torchbrdf.progress._PATIENCE", patience)
        said = Event()
        monkeypatch.setattr("torchbrdf.progress.announce", lambda text: (announce(text), said.set()))
        with told_if_slow("explaining the photograph"):
            assert said.wait(5.0 if patience == 0 else 0.0) == (patience == 0)
        assert capsys.readouterr().err == ("explaining the photograph\n" if patience == 0 else "")

    def test_what_takes_long_is_announced(self, capsys: pytest.CaptureFixture[str]) -> None:
        announce("it takes long")
        announce("unasked for", shown=False)
        assert capsys.readouterr().err == "it takes long\n"
