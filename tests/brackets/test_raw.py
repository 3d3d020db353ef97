"""Camera RAW, as a DNG file that is written here: its own colours balanced and turned to Rec. 709."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch

from merge_cases import texture
from torchbrdf.brackets import merge
from torchbrdf.images import write_image

BALANCE = (2.0, 1.0, 1.5)
MATRIX = (0.9, -0.2, -0.05, -0.4, 1.3, 0.1, -0.1, 0.2, 0.6)
BLACK, WHITE = 64, 4095
GREY = texture()[..., :1].repeat(3, axis=2)
TIMES = (1 / 200, 1 / 50, 1 / 12)

pytest.importorskip("rawpy")


def write_dng(path: Path, radiance: np.ndarray, time: float, balance: tuple[float, ...] = BALANCE) -> Path:
    """A mosaic of R, G, G, B, as a camera sees grey light that its white balance makes grey."""
    linear = np.clip(radiance * time / np.array(BALANCE), 0, 1)
    mosaic = np.empty(radiance.shape[:2])
    for row, column, k in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[row::2, column::2] = linear[row::2, column::2, k]
    codes = np.rint(mosaic * (WHITE - BLACK) + BLACK).astype("u2")

    def ratios(values):
        return tuple(number for value in values for number in (round(value * 10**4), 10**4))

    tags = [
        (271, "s", 0, "Maker", True), (272, "s", 0, "Model One", True), (50708, "s", 0, "Model One", True),
        (50706, "B", 4, (1, 4, 0, 0), True), (50707, "B", 4, (1, 1, 0, 0), True),
        (33421, "H", 2, (2, 2), True), (33422, "B", 4, (0, 1, 1, 2), True),
        (50714, "H", 1, BLACK, True), (50717, "H", 1, WHITE, True),
        (50721, "2i", 9, ratios(MATRIX), True), (50728, "2I", 3, ratios(1 / g for g in balance), True),
        (50778, "H", 1, 21, True), (33434, "2I", 1, (round(time * 10**6), 10**6), True),
    ]  # fmt: skip
    tifffile.imwrite(path, codes, photometric=32803, extratags=tags, metadata=None)
    return path


def test_grey_is_grey_and_has_its_radiance(tmp_path):
    found = merge([write_dng(tmp_path / f"{k}.dng", GREY, time) for k, time in enumerate(TIMES)])
    shown = (GREY[..., 0] > 0.5) & (GREY[..., 0] < 50)
    ratio = found.image.permute(1, 2, 0).numpy()[shown] / GREY[shown]
    assert np.median(ratio, axis=0) == pytest.approx(1, abs=0.01)
    assert np.percentile(np.abs(ratio - 1), 80) < 0.05


def test_another_set_takes_the_white_balance(tmp_path):
    probe = merge([write_dng(tmp_path / f"{k}.dng", GREY, time) for k, time in enumerate(TIMES)])
    write_image(tmp_path / "probe.exr", probe.image, probe.attributes)
    other = [write_dng(tmp_path / f"o{k}.dng", GREY, time, (1.2, 1.0, 3.0)) for k, time in enumerate(TIMES)]
    found = merge(other, like=tmp_path / "probe.exr")
    assert torch.allclose(found.image, probe.image, rtol=1e-3, equal_nan=True)


def test_a_damaged_file(tmp_path):
    for k in range(2):
        write_dng(tmp_path / f"{k}.dng", GREY, TIMES[k])
        (tmp_path / f"{k}.dng").write_bytes((tmp_path / f"{k}.dng").read_bytes()[:600])
    with pytest.raises(ValueError, match=r"\d\.dng: (not a readable camera RAW file|says no exposure time)"):
        merge([tmp_path / "0.dng", tmp_path / "1.dng"], [0.1, 0.2])


def test_without_rawpy(tmp_path, monkeypatch):
    monkeypatch.setattr("torchbrdf.brackets._raw.find_spec", lambda _: None)
    files = [write_dng(tmp_path / f"{k}.dng", GREY, time) for k, time in enumerate(TIMES)]
    with pytest.raises(
        ValueError, match=r"0\.dng: camera RAW is read by rawpy; install it: pip install 'torchbrdf\[raw\]'"
    ):
        merge(files)
