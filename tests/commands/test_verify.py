import os
from pathlib import Path

import pytest

from torchbrdf.brdf import MerlTable
from torchbrdf.cli import main


@pytest.fixture
def folder(merl_directory: Path, tmp_path: Path) -> Path:
    (tmp_path / "own").mkdir()
    os.link(merl_directory / "white.binary", tmp_path / "own" / "white.binary")
    return tmp_path / "own"


def lines(capsys: pytest.CaptureFixture[str], *paths: Path) -> list[str]:
    assert main(["verify", *map(str, paths)]) == 0
    return capsys.readouterr().out.splitlines()


def test_what_a_table_is(capsys, folder: Path):
    (line,) = [line for line in lines(capsys, folder) if line.startswith("  white: ")]
    assert "MERL, 90 x 90 x 180" in line
    assert "0.0% not measured, reflects at most " in line


def test_a_table_that_reflects_five_times_what_it_gets(capsys, folder: Path):
    white = MerlTable.open(folder / "white.binary")
    MerlTable(white.values * 8, white.valid).save(folder / "bright.binary")
    said = "\n".join(lines(capsys, folder))
    assert "warning: bright reflects " in said
    assert "; is it of another scale? divide it, or leave it out" in said
    assert "warning: bright and white are one measurement" in said


def test_a_fit_and_a_file_of_several_folders(capsys, folder: Path, merl_directory: Path, tmp_path: Path):
    (tmp_path / "ball").mkdir()
    os.link(merl_directory / "red.binary", tmp_path / "ball" / "brdf.binary")
    found = lines(capsys, folder, tmp_path / "ball", merl_directory / "teal.binary")
    assert found[0] == "3 sound: white, ball, teal"
    assert any(line.startswith("  ball: a fit on MERL's grid") for line in found)
