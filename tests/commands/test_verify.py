import os
from pathlib import Path

import pytest

from torchbrdf.brdf import MerlTable, above_horizon
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
    assert "MERL, f_r 0.239 to 0.255 1/sr, measured 100.0%, reflects at most 80.0% (at " in line


def test_what_to_be_warned_of(capsys, folder: Path):
    white = MerlTable.open(folder / "white.binary")
    MerlTable(white.values * 8, white.valid).save(folder / "bright.binary")
    assert main(["verify", "--strict", str(folder)]) == 3
    said = capsys.readouterr().err
    assert "warning: bright: reflects 6.40 times the light that comes in at " in said
    assert "warning: bright and white are one measurement" in said


def test_a_table_of_zeros_and_one_of_few_cells(capsys, folder: Path):
    white = MerlTable.open(folder / "white.binary")
    MerlTable(white.values * 0, white.valid).save(folder / "dark.binary")
    valid = white.valid.clone()
    valid[30:] = False
    MerlTable(white.values, valid).save(folder / "torn.binary")
    assert main(["verify", str(folder)]) == 0
    said = capsys.readouterr().err
    assert "warning: dark: reflects nothing: " in said
    assert "warning: torn: 57% of its cells were not measured; " in said


def test_what_was_measured_is_one_number(capsys, folder: Path):
    """Of `repr`, of `verify` and of `convert`: the share of the cells above the horizon."""
    white = MerlTable.open(folder / "white.binary")
    valid = white.valid.clone()
    valid[30:] = False
    table = MerlTable(white.values, valid, "torn")
    share = f"{float(valid.sum()) / float(above_horizon().sum()):.1%}"
    assert share == f"{table.measured_share:.1%}"
    assert f"MerlTable('torn', measured {share}, f_r" in repr(table)
    table.save(folder / "torn.binary")
    assert any(f"  torn: MERL, f_r 0.239 to 0.255 1/sr, measured {share}, " in line for line in lines(capsys, folder))
    assert main(["convert", str(folder / "torn.binary"), str(folder / "again.binary")]) == 0
    said = capsys.readouterr().out
    assert f"measured {share}, " in said
    assert f"over the {share} of the cells above the horizon that both measured" in said


def test_a_fit_and_a_file_of_several_folders(capsys, folder: Path, merl_directory: Path, tmp_path: Path):
    (tmp_path / "ball").mkdir()
    os.link(merl_directory / "red.binary", tmp_path / "ball" / "brdf.binary")
    found = lines(capsys, folder, tmp_path / "ball", merl_directory / "teal.binary")
    assert found[0] == "3 sound: white, ball, teal"
    assert any(line.startswith("  ball: fit, f_r ") for line in found)


@pytest.mark.parametrize(
    ("materials", "said"),
    [(("brass", "white"), ["1 of the 2 MERL materials are missing: brass"]), (("brass", "steel", "white"), [])],
)
def test_missing_materials_are_said_where_half_are_there(capsys, monkeypatch, folder: Path, materials, said):
    for place in ("torchbrdf.brdf", "torchbrdf.brdf.verification"):
        monkeypatch.setattr(f"{place}.MERL_MATERIALS", materials)
    assert [line for line in lines(capsys, folder) if "missing" in line] == said


def test_nothing_there(capsys, tmp_path: Path):
    assert main(["verify", str(tmp_path / "gone")]) == 2
    assert capsys.readouterr().err.startswith(f"torchbrdf: error: {tmp_path / 'gone'}: no such file; expected")
