from dataclasses import replace

import numpy as np
import pytest
import torch

from materials import glossy, lambert
from torchbrdf.brdf.merl import GRID, MerlTable, cell_centres
from torchbrdf.brdf.texture import LAYERS, brdf_texture


def test_a_constant_stays_one():
    texture, scale = brdf_texture(MerlTable.from_function(lambert(0.5, 0.2, 0.1)))
    assert (texture.shape, texture.dtype) == ((LAYERS, 90, 90, 3), np.dtype("<f2"))
    assert np.allclose(texture.astype(float) * scale, np.array([0.5, 0.2, 0.1]) / np.pi, rtol=6e-4)


def test_axes_and_means():
    """f_r = theta_h + 10 theta_d + 100 phi_d, in units of cells, comes out in the texture's order."""
    h, d, phi = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in GRID), indexing="ij")
    values = (h + 10 * d + 100 * phi)[..., None].expand(*GRID, 3)
    texture, scale = brdf_texture(MerlTable(values, torch.ones(GRID, dtype=torch.bool)))
    found = texture.astype(float) * scale
    for phi, d, h in ((0, 10, 20), (5, 40, 3), (11, 0, 0), (6, 60, 12)):
        assert found[phi, d, h, 1] == pytest.approx(h + 10 * d + 100 * (15 * phi + 7), rel=1e-3)


def test_layers_prefer_measured_cells():
    table = MerlTable.from_function(lambert(0.5, 0.5, 0.5))
    valid = table.valid.clone()
    values = table.values.clone()
    valid[20, 20, 31:44], values[20, 20, 31:44] = False, float("nan")
    values[20, 20, 30], values[20, 20, 44] = 1.0, 3.0
    valid[50, 5], values[50, 5] = False, 1e9
    texture, scale = brdf_texture(MerlTable(values, valid))
    assert texture[2, 20, 20, 0] * scale == pytest.approx(2.0, rel=1e-3)
    assert (texture[:, 5, 50, 0] * scale).tolist() == pytest.approx([0.5 / np.pi] * LAYERS, rel=1e-3)


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
def test_no_peak_is_too_high(factor):
    table = MerlTable.from_function(glossy((0.01, 0.01, 0.005), (0.9, 0.7, 0.3), 0.005))
    texture, scale = brdf_texture(replace(table, values=factor * table.values))
    assert np.isfinite(texture).all()
    assert 2**14 <= texture.max() <= 2**15
    assert float(np.log2(scale)).is_integer()
    expected = factor * table.filled.reshape(*GRID, 3)[0, 0].mean(0)
    assert texture[:, 0, 0].astype(float).mean(0) * scale == pytest.approx(expected.numpy(), rel=1e-3)


def test_black_and_negative():
    black = MerlTable.from_function(lambert(0.0, 0.0, 0.0))
    assert not brdf_texture(black)[0].any()
    texture, _ = brdf_texture(replace(black, values=black.values - 1.0))
    assert not texture.any()


def test_theta_h_keeps_its_warp():
    theta_h = cell_centres()[0].ravel()
    table = MerlTable(theta_h[:, None, None, None].expand(*GRID, 3), torch.ones(GRID, dtype=torch.bool))
    texture, scale = brdf_texture(table)
    found = texture[4, 9, :85, 2].astype(float) * scale
    assert found.tolist() == pytest.approx(theta_h[:85].tolist(), rel=1e-3, abs=1e-4)
