import os
from pathlib import Path

import numpy as np
import pytest

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.verification import verify


def test_verify_says_what_is_sound_what_is_wrong_and_what_is_missing(merl_directory: Path, tmp_path: Path):
    sound = merl_directory / "white.binary"
    os.link(sound, tmp_path / "brass.binary")
    os.link(sound, tmp_path / "my-own-paint.binary")
    whole = sound.read_bytes()
    (tmp_path / "chrome.binary").write_bytes(whole[:-8])
    (tmp_path / "nylon.binary").write_bytes(whole + b"\0")
    (tmp_path / "steel.binary").write_bytes(np.array([180, 90, 90], "<i4").tobytes() + whole[12:])
    (tmp_path / "teflon.binary").write_bytes(whole[:12] + np.array([np.nan], "<f8").tobytes() + whole[20:])
    (tmp_path / "pvc.binary").mkdir()
    (tmp_path / "._brass.binary").write_bytes(b"\0\5\x16\7")
    report = verify(tmp_path)
    assert report.folders == (tmp_path,)
    assert set(report.sound) == {"brass", "my-own-paint"}
    assert set(report.unsound) == {"chrome", "nylon", "steel", "teflon", "pvc"}
    assert "truncated" in report.unsound["chrome"]
    assert "oversized" in report.unsound["nylon"]
    assert "(180, 90, 90)" in report.unsound["steel"]
    assert "1 cells of the table are NaN or infinite" in report.unsound["teflon"]
    assert all("\n" not in reason for reason in report.unsound.values())
    assert len(report.missing) == 100 - 6
    assert "alum-bronze" in report.missing
    assert not {"brass", "chrome", "steel"} & set(report.missing)


def test_verify_calls_a_table_without_one_measured_cell_unsound(tmp_path: Path):
    blank = np.array([90, 90, 180], "<i4").tobytes() + np.full(3 * 1458000, -1.0, "<f8").tobytes()
    (tmp_path / "nickel.binary").write_bytes(blank)
    report = verify(tmp_path)
    assert report.sound == ()
    assert "measured" in report.unsound["nickel"]


def test_kind_range_holes_and_albedo(tiny_tables: dict[str, MerlTable], tmp_path: Path):
    table = tiny_tables["white"]
    valid = table.valid.clone()
    valid[:, 45:] = False
    MerlTable(table.values, valid).save(tmp_path / "white.binary")
    (found,) = verify(tmp_path / "white.binary").tables
    assert (found.name, found.kind) == ("white", "MERL")
    assert (found.least, found.most) == pytest.approx((0.75 / np.pi, 0.8 / np.pi))
    assert found.holes == pytest.approx(1 - float(valid.sum() / table.valid.sum()))
    assert found.albedo[0].tolist() == pytest.approx([0.8, 0.8, 0.75])


def test_a_result_of_fit_is_called_after_its_folder(merl_directory: Path, tmp_path: Path):
    (tmp_path / "mug").mkdir()
    os.link(merl_directory / "white.binary", tmp_path / "mug" / "brdf.binary")
    (found,) = verify(tmp_path / "mug").tables
    assert (found.name, found.kind) == ("mug", "fit")


def test_an_rgl_material(shared_data: Path):
    (found,) = verify(shared_data / "rgl" / "vch_golden_yellow_rgb.bsdf").tables
    assert found.kind == "RGL"
    assert 0 < found.holes < 0.5


def test_the_embedded_library(monkeypatch: pytest.MonkeyPatch, default_library, merl_directory: Path):
    two = default_library.subset(["brass", "pvc"])
    monkeypatch.setattr("torchbrdf.brdf.library.MaterialLibrary.default", lambda _: two)
    found = verify(["default", merl_directory / "red.binary"])
    assert [(table.name, table.kind) for table in found.tables] == [
        ("brass", "embedded"), ("pvc", "embedded"), ("red", "MERL")
    ]  # fmt: skip


def test_one_measurement_under_two_names(tiny_tables: dict[str, MerlTable], tmp_path: Path):
    red = tiny_tables["red"]
    red.save(tmp_path / "red.binary")
    MerlTable(red.values * 3, red.valid).save(tmp_path / "again.binary")
    assert verify(tmp_path).same == (("again", "red"),)


def test_several_folders_and_files(merl_directory: Path, tmp_path: Path):
    (tmp_path / "mine").mkdir()
    os.link(merl_directory / "red.binary", tmp_path / "mine" / "red.binary")
    os.link(merl_directory / "white.binary", tmp_path / "snow.binary")
    found = verify([tmp_path / "mine", tmp_path / "snow.binary"])
    assert found.sound == ("red", "snow")
    assert found.folders == (tmp_path / "mine", tmp_path)
