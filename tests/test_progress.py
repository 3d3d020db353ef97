"""Bars of progress: shown where they are asked for, and not while they are hidden."""

import pytest

from torchbrdf.progress import above_bars, no_progress, progress_bar


def counted(**settings: bool) -> list[int]:
    return list(progress_bar([1, 2, 3], desc="materials", mininterval=0, **settings))


@pytest.mark.parametrize("shown", [True, False])
def test_shown_where_it_is_asked_for(shown: bool, capsys: pytest.CaptureFixture[str]) -> None:
    assert counted(shown=shown) == [1, 2, 3]
    captured = capsys.readouterr()
    assert ("materials: 100%" in captured.err) == shown
    assert captured.out == ""


def test_hidden_in_blocks_also_in_one_another(capsys: pytest.CaptureFixture[str]) -> None:
    with no_progress():
        with no_progress():
            assert counted() == [1, 2, 3]
        assert counted() == [1, 2, 3]
        assert capsys.readouterr().err == ""
    counted()
    assert "materials" in capsys.readouterr().err


def test_shown_again_after_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="bad"), no_progress():
        raise ValueError("bad")
    counted()
    assert "materials" in capsys.readouterr().err


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
