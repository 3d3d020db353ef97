"""Commands that must fail: exit status 2, one line, no output."""

from torchbrdf.cli import main


def fails(capsys, *arguments: object) -> str:
    """Run a command that must fail; returns its one line."""
    assert main([str(argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if "warning:" not in line]
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("torchbrdf: error: ")
    assert captured.out == ""
    return lines[0]


def assert_fit_fails(capsys, tmp_path, photo, *more: object) -> str:
    out = tmp_path / "results" / "out"
    before = sorted(tmp_path.rglob("*"))
    line = fails(capsys, "fit", photo, *(more if "--probe" in more else ("--probe", "default", *more)), "-o", out)
    assert sorted(tmp_path.rglob("*")) == before, "a failed command left something behind"
    return line
