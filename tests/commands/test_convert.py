"""`torchbrdf convert`: what it writes, says and refuses."""

from pathlib import Path

import pytest

from failures import fails
from torchbrdf.brdf.tables import read_table
from torchbrdf.cli import main


def test_there_and_back(capsys, merl_directory: Path, tmp_path: Path):
    assert main(["convert", str(merl_directory / "red.binary"), str(tmp_path / "red.bsdf")]) == 0
    assert "for Mitsuba's RGB variants" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / "red.bsdf"), "-o", str(tmp_path / "red.binary")]) == 0
    assert "read again, it differs by l2 0.00%, log 0.00%, cube-root 0.00%" in capsys.readouterr().out
    assert read_table(tmp_path / "red.binary").valid.any()


def test_other_suffixes(capsys, merl_directory: Path, tmp_path: Path):
    line = fails(capsys, "convert", merl_directory / "red.binary", tmp_path / "red.txt")
    assert line.endswith("red.txt: tables are written as .binary or .bsdf; name the output so")


@pytest.mark.parametrize("named", [[], ["x.bsdf", "-o", "x.binary"]])
def test_one_file_to_write(capsys, merl_directory: Path, named: list[str]):
    assert fails(capsys, "convert", merl_directory / "red.binary", *named).endswith(
        "give one file to write, behind the table or with -o"
    )


def test_spectral_is_for_a_bsdf(capsys, merl_directory: Path, tmp_path: Path):
    line = fails(capsys, "convert", merl_directory / "red.binary", tmp_path / "x.binary", "--spectral")
    assert "--spectral is for a .bsdf file" in line


def test_a_broken_file_leaves_nothing(capsys, tmp_path: Path):
    (tmp_path / "x.bsdf").write_bytes(b"tensor_file\0\1\0\1")
    line = fails(capsys, "convert", tmp_path / "x.bsdf", tmp_path / "x.binary")
    assert "x.bsdf: truncated" in line
    assert not (tmp_path / "x.binary").exists()
