import itertools
import math
import re
from math import pi
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from torch import Tensor

from torchbrdf.analytic import model_of
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.brdf import merl
from torchbrdf.brdf.directions import from_half_difference
from torchbrdf.brdf.merl import LARGEST, MerlTable, above_horizon, cell_centres, cell_index, nearest_measured

SHAPE = (90, 90, 180)
CELLS = 90 * 90 * 180
FILE_BYTES = 34_992_012
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0


def write_file(path: Path, planes: np.ndarray, header: tuple[int, ...] = SHAPE) -> Path:
    """A MERL file written by hand from stored values: planes (3, 1458000), or fewer cells."""
    path.write_bytes(np.array(header, "<i4").tobytes() + np.ascontiguousarray(planes, "<f8").tobytes())
    return path


@pytest.fixture(scope="module")
def stored() -> np.ndarray:
    """Random stored values over several decades, a twentieth of the cells negative in one channel or all."""
    rng = np.random.default_rng(5)
    planes = np.exp(rng.normal(0, 3, (3, CELLS)))
    holes = rng.random(CELLS)
    planes[:, holes < 0.03] = -1.0
    planes[1, (holes > 0.03) & (holes < 0.05)] = -0.5
    return planes


@pytest.fixture(scope="module")
def opened(stored: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> MerlTable:
    return MerlTable.open(write_file(tmp_path_factory.mktemp("stored") / "random.binary", stored))


def centre(h: float, d: float, p: float) -> tuple[Tensor, Tensor]:
    """The pair of directions of fractional grid coordinates: (h + 0.5, ...) is the centre of cell h."""
    angles = ((h / 90) ** 2 * pi / 2, d / 90 * pi / 2, p / 180 * pi)
    return from_half_difference(*(torch.tensor(a, dtype=torch.float64) for a in angles))


def visible_cells(count: int, seed: int) -> list[tuple[int, int, int]]:
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, SHAPE, (4 * count, 3))
    mask = above_horizon().numpy()
    return [tuple(int(i) for i in c) for c in cells if mask[tuple(c)]][:count]


def test_values_are_stored_values_times_the_channel_scale(stored: np.ndarray, opened: MerlTable):
    by_hand = stored.reshape(3, *SHAPE)
    values, valid = opened.values.numpy(), opened.valid.numpy()
    for h, d, p in visible_cells(500, 1):
        cell = by_hand[:, h, d, p]
        assert valid[h, d, p] == (cell >= 0).all()
        if valid[h, d, p]:
            np.testing.assert_allclose(values[h, d, p], cell * SCALE, rtol=1e-15)


def test_unmeasured_cells_are_the_negative_ones_and_those_below_the_horizon(stored: np.ndarray, opened: MerlTable):
    measured = (stored >= 0).all(0).reshape(SHAPE)
    assert 0.94 < measured.mean() < 0.96
    assert np.array_equal(opened.valid.numpy(), measured & above_horizon().numpy())


def test_the_horizon_is_where_a_direction_of_the_pair_turns_below_it():
    w_i, w_o = from_half_difference(*cell_centres())
    assert torch.equal(above_horizon(), (w_i[..., 2] > 0) & (w_o[..., 2] > 0))


def test_three_quarters_of_the_cells_lie_above_the_horizon():
    """Counted by the two cosines written out, not by `from_half_difference`."""
    theta_h = ((np.arange(90) + 0.5) / 90) ** 2 * (pi / 2)
    theta_d, phi_d = (np.arange(90) + 0.5) / 90 * (pi / 2), (np.arange(180) + 0.5) / 180 * pi
    h, d, p = np.meshgrid(theta_h, theta_d, phi_d, indexing="ij")
    base, swing = np.cos(h) * np.cos(d), np.sin(h) * np.sin(d) * np.cos(p)
    mask = above_horizon().numpy()
    assert mask.mean() == pytest.approx(0.75, abs=0.01)
    differ = mask != ((base - swing > 0) & (base + swing > 0))
    assert (np.minimum(np.abs(base - swing), np.abs(base + swing))[differ] < 1e-12).all()


def test_write_then_read_is_exact_to_float64_rounding(opened: MerlTable, tmp_path: Path):
    opened.save(tmp_path / "again.binary")
    again = MerlTable.open(tmp_path / "again.binary")
    assert torch.equal(again.valid, opened.valid)
    a, b = again.values[again.valid], opened.values[opened.valid]
    assert float(((a - b).abs() / b).max()) <= 2 * torch.finfo(torch.float64).eps
    assert again.name == "again"


def test_saved_file_has_the_header_length_and_order_of_merl(tmp_path: Path):
    g = torch.Generator().manual_seed(2)
    values = torch.rand(*SHAPE, 3, generator=g, dtype=torch.float64)
    MerlTable(values, torch.ones(SHAPE, dtype=torch.bool)).save(tmp_path / "t.binary")
    raw = (tmp_path / "t.binary").read_bytes()
    assert len(raw) == FILE_BYTES
    assert np.frombuffer(raw, "<i4", 3).tolist() == [90, 90, 180]
    planes = np.frombuffer(raw, "<f8", offset=12)
    for h, d, p in visible_cells(100, 3):
        flat = p + 180 * (d + 90 * h)
        for channel in range(3):
            expected = float(values[h, d, p, channel]) / SCALE[channel]
            assert planes[flat + channel * CELLS] == pytest.approx(expected, rel=1e-14)


def test_save_writes_unmeasured_cells_as_minus_one_and_clamps_negative_results(tmp_path: Path):
    values = torch.full((*SHAPE, 3), 0.5, dtype=torch.float64)
    valid = torch.ones(SHAPE, dtype=torch.bool)
    valid[10, 3, 7] = False
    values[10, 3, 7] = float("nan")
    values[12, 3, 7] = -0.25
    MerlTable(values, valid).save(tmp_path / "t.binary")
    planes = np.fromfile(tmp_path / "t.binary", "<f8", offset=12).reshape(3, *SHAPE)
    assert (planes[:, 10, 3, 7] == -1).all()
    assert (planes[:, 12, 3, 7] == 0).all()
    assert (planes[:, ~above_horizon().numpy()] == -1).all()
    again = MerlTable.open(tmp_path / "t.binary")
    assert not again.valid[10, 3, 7]
    assert again.valid[12, 3, 7]


def test_interrupted_save_keeps_the_file_that_was_there(
    opened: MerlTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "t.binary"
    path.write_bytes(b"before")

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(torch.Tensor, "clamp_min_", interrupted)  # after the header was written
    with pytest.raises(KeyboardInterrupt):
        opened.save(path)
    monkeypatch.undo()
    assert path.read_bytes() == b"before"
    assert [p.name for p in tmp_path.iterdir()] == ["t.binary"]


class TestUnsoundFiles:
    def refused(self, path: Path, *expected: str) -> None:
        with pytest.raises(ValueError, match=r"MERL|NaN|measured|exceed") as caught:
            MerlTable.open(path)
        message = str(caught.value)
        assert "\n" not in message
        assert str(path) in message
        for part in expected:
            assert part in message

    def test_absent(self, tmp_path: Path):
        with pytest.raises(FileNotFoundError, match=r"gone\.binary: no such file; expected a MERL \.binary table"):
            MerlTable.open(tmp_path / "gone.binary")

    def test_empty(self, tmp_path: Path):
        (tmp_path / "t.binary").write_bytes(b"")
        self.refused(tmp_path / "t.binary", "is empty (0 bytes); expected a MERL .binary table")

    def test_git_lfs_pointer(self, tmp_path: Path):
        (tmp_path / "t.binary").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n")
        with pytest.raises(ValueError, match=r"t\.binary: is a Git LFS pointer; `git lfs pull`"):
            MerlTable.open(tmp_path / "t.binary")

    def test_folder(self, tmp_path: Path):
        with pytest.raises(IsADirectoryError, match=r": is a folder; expected a MERL \.binary table$"):
            MerlTable.open(tmp_path)

    def test_all_of_phi_d(self, tmp_path: Path):
        """As files of BRDFs that are not reciprocal have it: 90 x 90 x 360."""
        path = write_file(tmp_path / "t.fullbin", np.zeros((3, 1)), (90, 90, 360))
        self.refused(path, "a MERL table of all of phi_d, (90, 90, 360)", "write that half of it")

    def test_shorter_than_a_header(self, tmp_path: Path):
        (tmp_path / "t.binary").write_bytes(b"\x5a\0\0\0\x5a\0\0")
        self.refused(tmp_path / "t.binary", "not a MERL table: the header must be (90, 90, 180)")

    def test_text(self, tmp_path: Path):
        (tmp_path / "t.binary").write_text("not a table at all")
        self.refused(tmp_path / "t.binary", "not a MERL table")

    @pytest.mark.parametrize("header", [(180, 90, 90), (90, 180, 90), (1, 1, CELLS), (-90, -90, 180)])
    def test_right_length_under_another_header(self, stored: np.ndarray, tmp_path: Path, header: tuple[int, ...]):
        """The product of the dimensions, and so the length, is right: only the header gives it away."""
        path = write_file(tmp_path / "t.binary", stored, header)
        assert path.stat().st_size == FILE_BYTES
        self.refused(path, f"the header must be (90, 90, 180), got {header}")

    @pytest.mark.parametrize("missing", [1, 8, CELLS * 8])
    def test_truncated(self, stored: np.ndarray, tmp_path: Path, missing: int):
        path = write_file(tmp_path / "t.binary", stored)
        with open(path, "r+b") as file:
            file.truncate(FILE_BYTES - missing)
        expected = f"truncated MERL table: expected 34992012 bytes, got {FILE_BYTES - missing}"
        self.refused(path, expected)

    def test_oversized(self, stored: np.ndarray, tmp_path: Path):
        path = write_file(tmp_path / "t.binary", stored)
        with open(path, "ab") as file:
            file.write(b"\0")
        self.refused(path, "oversized MERL table: expected 34992012 bytes, got 34992013")

    def test_header_that_asks_for_terabytes_allocates_nothing(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        path = write_file(tmp_path / "t.binary", np.zeros((3, 1)), (2**31 - 1, 2**31 - 1, 2**31 - 1))
        monkeypatch.setattr(np, "fromfile", None)
        self.refused(path, "got (2147483647, 2147483647, 2147483647)")

    def test_terabytes_after_a_sound_header_are_not_read(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        """A sparse file of 1 TB."""
        path = write_file(tmp_path / "t.binary", np.zeros((3, 1)))
        with open(path, "r+b") as file:
            try:
                file.truncate(2**40)
            except OSError:
                pytest.skip("this file system holds no sparse file of 1 TB")
        monkeypatch.setattr(np, "fromfile", None)
        self.refused(path, "oversized", str(2**40))

    @pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
    def test_nan_or_infinity_above_the_horizon(self, stored: np.ndarray, tmp_path: Path, value: float):
        planes = np.abs(stored)
        planes[2, [0, 5]] = value
        path = write_file(tmp_path / "t.binary", planes)
        self.refused(path, f"{path}: 2 cells of the table are NaN or infinite; the file is damaged: download")

    @pytest.mark.parametrize("value", [float("nan"), float("inf")])
    def test_nan_beside_a_negative_channel_is_still_found(self, stored: np.ndarray, tmp_path: Path, value: float):
        planes = np.abs(stored)
        planes[:, 0] = (-1.0, value, 1.0)
        self.refused(write_file(tmp_path / "t.binary", planes), "1 cells of the table are NaN or infinite")

    @pytest.mark.parametrize("value", [1e16, 1e40, 1e300])
    def test_more_than_any_mirror(self, stored: np.ndarray, tmp_path: Path, value: float):
        planes = np.abs(stored)
        planes[0, [0, 5, 7]] = value
        path = write_file(tmp_path / "t.binary", planes)
        said = f"{path}: 3 cells of the table exceed 1e+11 1/sr, up to {value / 1500:.2g}, which no BRDF can"
        self.refused(path, said)

    def test_file_without_one_measured_cell(self, tmp_path: Path):
        """A directory of such files must not end in a traceback: it is an unsound table."""
        path = write_file(tmp_path / "t.binary", np.full((3, CELLS), -1.0))
        self.refused(path)


def test_constructor_names_the_shapes():
    with pytest.raises(
        ValueError, match=r"needs values \(90, 90, 180, 3\) and valid \(90, 90, 180\), got \(2, 3\) and"
    ):
        MerlTable(torch.zeros(2, 3), torch.ones(SHAPE, dtype=torch.bool))


def test_constructor_refuses_nan_where_measured():
    values = torch.zeros(*SHAPE, 3)
    values[0, 0, 0, 1] = float("nan")
    with pytest.raises(ValueError, match="odd: 1 cells of the table are NaN or infinite"):
        MerlTable(values, torch.ones(SHAPE, dtype=torch.bool), "odd")


def test_the_bound_lies_above_every_mirror_that_the_grid_resolves():
    """Light spread over the half vectors of the smallest cell, all of it reflected, at the grazing end of the grid."""
    cap = 2 * pi * (1 - math.cos(pi / 2 / 90**2))
    cosine = math.cos(89.5 / 90 * pi / 2)
    assert 1 / (4 * cap * cosine**2) < LARGEST < 10 / (4 * cap * cosine**2)


def test_a_sharp_mirror_passes(tmp_path: Path):
    """GGX of alpha 0.001, the sharpest that `analytic` fits: 1e9 1/sr at grazing angles."""
    model = model_of("ggx")
    numbers = {"diffuse": 0.0, "specular": 1.0, "roughness": 1e-3}
    parameters = {name: torch.full((1,), number, dtype=torch.float64) for name, number in numbers.items()}
    above = above_horizon()
    values = torch.zeros(*SHAPE, 3, dtype=torch.float64)
    angles = (angle[above] for angle in torch.broadcast_tensors(*cell_centres()))
    values[above] = model.evaluate(parameters, ShadingGeometry.of_angles(*angles))
    table = MerlTable(values, above)
    assert float(table.values[table.valid].max()) > 1e8


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e300])
def test_what_was_not_measured_may_hold_anything(stored: np.ndarray, tmp_path: Path, value: float):
    """Below the horizon models divide by a cosine of 0."""
    planes = np.abs(stored)
    planes[:, ~above_horizon().numpy().ravel()] = value
    assert torch.isfinite(MerlTable.open(write_file(tmp_path / "t.binary", planes)).filled).all()


def test_constructor_refuses_a_table_without_measured_cells():
    with pytest.raises(ValueError, match="blank: the table has no measured cell"):
        MerlTable(torch.zeros(*SHAPE, 3), torch.zeros(SHAPE, dtype=torch.bool), "blank")


class TestNearestMeasured:
    def test_no_measured_cell_is_nearer(self):
        """By all distances, in cells, phi_d periodic."""
        valid = above_horizon()
        found = nearest_measured(valid)
        measured = torch.nonzero(valid)
        assert valid.ravel()[found].all()
        assert torch.equal(found[valid.ravel()], torch.nonzero(valid.ravel()).ravel())
        for cell in torch.nonzero(~valid.ravel()).ravel()[::9973].tolist():
            h, d, p = cell // (90 * 180), cell // 180 % 90, cell % 180
            around = (measured[:, 2] - p).abs()
            apart = (measured[:, 0] - h) ** 2 + (measured[:, 1] - d) ** 2 + torch.minimum(around, 180 - around) ** 2
            i, j, k = found[cell] // (90 * 180), found[cell] // 180 % 90, found[cell] % 180
            beside = min(abs(int(k) - p), 180 - abs(int(k) - p))
            assert (int(i) - h) ** 2 + (int(j) - d) ** 2 + beside**2 == int(apart.min())

    def test_gradients_flow_where_it_was_first_found_in_inference_mode(self):
        holed = above_horizon().clone()
        holed[3, 3, :9] = False
        merl._nearest_above_horizon.cache_clear()
        merl._nearest_measured.cache_clear()
        for valid in (above_horizon(), holed):
            with torch.inference_mode():
                nearest_measured(valid)
            values = torch.ones(*SHAPE, 3, requires_grad=True)
            MerlTable(values, valid).filled.sum().backward()
            assert values.grad is not None
            assert float(values.grad.sum()) == 3 * CELLS

    def test_gradients_flow_after_a_look_without_and_more_than_once(self):
        values = torch.ones(*SHAPE, 3, requires_grad=True)
        table = MerlTable(values, above_horizon())
        with torch.no_grad():
            assert not table.filled.requires_grad
        for times in (1, 2):
            table.filled.sum().backward()
            assert float(values.grad.sum()) == 3 * CELLS * times

    def test_what_is_written_into_a_table_is_seen(self):
        table = MerlTable(torch.ones(*SHAPE, 3), above_horizon())
        assert table.filled is table.filled
        table.values.mul_(2)
        assert bool((table.filled == 2).all())

    def test_of_whole_tables_is_read_from_the_cache(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path))
        monkeypatch.setattr(merl, "_nearest_above_horizon", merl._nearest_above_horizon.__wrapped__)
        made = nearest_measured(above_horizon())
        (kept,) = (tmp_path / "grids").iterdir()
        monkeypatch.setattr(merl, "_nearest_measured", None)  # made once
        assert torch.equal(nearest_measured(above_horizon()), made)
        assert torch.equal(nearest_measured(above_horizon().ravel()), made)
        monkeypatch.undo()
        assert torch.equal(merl._nearest_measured(above_horizon().numpy().tobytes()), made)
        assert kept.stat().st_size < 6e6


class TestLookup:
    def test_nearest_reads_the_cell_that_holds_the_directions(self, opened: MerlTable):
        rng = np.random.default_rng(7)
        inside = rng.uniform(0.02, 0.98, (1000, 3))
        tried = 0
        for (h, d, p), (u, v, w) in zip(visible_cells(1000, 8), inside, strict=True):
            w_i, w_o = centre(h + u, d + v, p + w)
            if not opened.valid[h, d, p] or w_i[2] <= 0 or w_o[2] <= 0:
                continue
            tried += 1
            assert torch.equal(opened.lookup(w_i, w_o), opened.values[h, d, p]), (h, d, p)
        assert tried > 800

    def test_reciprocity(self, opened: MerlTable):
        """A grid without its own symmetry: only phi_d -> phi_d + pi makes both readings agree."""
        cells = visible_cells(500, 9)
        pairs = [centre(h + 0.5, d + 0.5, p + 0.5) for h, d, p in cells]
        w_i, w_o = (torch.stack(w) for w in zip(*pairs, strict=True))
        for interpolation in ("nearest", "linear"):
            there, back = opened.lookup(w_i, w_o, interpolation), opened.lookup(w_o, w_i, interpolation)
            assert torch.allclose(there, back, rtol=1e-9)
        assert len(torch.unique(opened.lookup(w_i, w_o), dim=0)) > 400

    def test_below_the_horizon_is_zero(self, opened: MerlTable):
        up, down = torch.tensor([0.6, 0.0, 0.8]), torch.tensor([0.0, 0.6, -0.8])
        for interpolation in ("nearest", "linear"):
            assert float(opened.lookup(up, up, interpolation).min()) > 0
            for pair in ((up, down), (down, up), (down, down), (down, -down), (up, -up)):
                assert float(opened.lookup(*pair, interpolation).abs().max()) == 0

    @pytest.mark.parametrize("interpolation", ["nearest", "linear"])
    @pytest.mark.parametrize("axis", [0, 2])
    def test_nan_of_a_direction_that_is_not_known(self, opened: MerlTable, interpolation: str, axis: int):
        up, off = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([0.0, 0.0, 1.0])
        off[axis] = torch.nan
        for w_i, w_o in ((up, off), (off, up)):
            assert opened.lookup(w_i, w_o, interpolation).isnan().all()

    @pytest.mark.parametrize("interpolation", ["nearest", "linear"])
    @pytest.mark.parametrize("shape", [(3, 5), (4,), (2,), (5, 1)])
    def test_component_first_vectors_are_refused(self, opened: MerlTable, interpolation: str, shape: tuple[int, ...]):
        odd, up = torch.ones(shape), torch.tensor([0.0, 0.0, 1.0])
        with pytest.raises(ValueError, match=rf"^w_i must be \(\.\.\., 3\), got {re.escape(str(shape))}$"):
            opened.lookup(odd, up, interpolation)
        with pytest.raises(ValueError, match=r"^w_o must be "):
            opened.lookup(up, odd, interpolation)

    def test_linear_equals_nearest_at_the_centres(self, opened: MerlTable):
        for h, d, p in visible_cells(300, 10):
            if opened.valid[h, d, p]:
                linear = opened.lookup(*centre(h + 0.5, d + 0.5, p + 0.5), "linear")
                assert torch.allclose(linear, opened.values[h, d, p], rtol=1e-6)

    def test_linear_is_the_weighted_sum_of_eight_cells(self, opened: MerlTable):
        """Written out by hand, phi_d periodic over half a turn (reciprocity)."""
        rng = np.random.default_rng(11)
        offsets = rng.uniform(0, 1, (400, 3))
        tried = wrapped = 0
        cells = visible_cells(350, 12) + [(h, 20, 179) for h in range(10, 60)]
        for (h, d, p), f in zip(cells, offsets, strict=True):
            if h == 89 or d == 89:
                continue
            corners = list(itertools.product((0, 1), repeat=3))
            where = [(h + a, d + b, (p + c) % 180) for a, b, c in corners]
            w_i, w_o = centre(h + 0.5 + f[0], d + 0.5 + f[1], p + 0.5 + f[2])
            if not all(opened.valid[w] for w in where) or min(w_i[2], w_o[2]) <= 0:
                continue
            shares = [np.prod([f[k] if c[k] else 1 - f[k] for k in range(3)]) for c in corners]
            expected = sum(s * opened.values[w] for s, w in zip(shares, where, strict=True))
            assert torch.allclose(opened.lookup(w_i, w_o, "linear"), expected, rtol=1e-6)
            tried += 1
            wrapped += p == 179
        assert tried > 150
        assert wrapped > 15

    @pytest.mark.parametrize("interpolation", ["nearest", "linear"])
    def test_unmeasured_cells_never_read_as_zero(self, interpolation: str):
        """A constant table with many holes, and with cells that reach over the horizon, looks up as the constant."""
        g = torch.Generator().manual_seed(4)
        valid = torch.rand(SHAPE, generator=g) > 0.4
        values = torch.where(valid[..., None], 0.7, torch.tensor(float("nan"), dtype=torch.float64))
        table = MerlTable(values.expand(*SHAPE, 3).contiguous(), valid)
        d = torch.nn.functional.normalize(torch.randn(2, 20000, 3, generator=g, dtype=torch.float64), dim=-1)
        d[..., 2].abs_()
        f_r = table.lookup(d[0], d[1], interpolation)
        assert float((f_r - 0.7).abs().max()) < 1e-12

    def test_linear_error_falls_by_the_square_of_the_grid(self):
        """On a smooth function linear lookup is far closer than nearest."""
        table = MerlTable.from_function(lambda a, b: (1 + a[..., 2:] * b[..., 2:]).expand(*a.shape[:-1], 3))
        g = torch.Generator().manual_seed(6)
        d = torch.nn.functional.normalize(torch.randn(2, 5000, 3, generator=g, dtype=torch.float64), dim=-1)
        d[..., 2].abs_()
        d = d[:, (d[..., 2] > 0.2).all(0)]
        truth = (1 + d[0][:, 2:] * d[1][:, 2:]).expand(-1, 3)
        nearest = float((table.lookup(d[0], d[1]) - truth).abs().max())
        linear = float((table.lookup(d[0], d[1], "linear") - truth).abs().max())
        assert nearest < 0.03
        assert linear < 0.02 * nearest

    def test_shapes_broadcast_and_precision_follows_the_directions(self, opened: MerlTable):
        g = torch.Generator().manual_seed(1)
        d = torch.nn.functional.normalize(torch.randn(7, 3, generator=g), dim=-1)
        d[:, 2].abs_()
        for interpolation in ("nearest", "linear"):
            f_r = opened.lookup(d[:, None], d[None, :5], interpolation)
            assert f_r.shape == (7, 5, 3)
            assert f_r.dtype == torch.float32
            assert torch.allclose(f_r[3, 4], opened.lookup(d[3], d[4], interpolation), rtol=1e-4)
            assert opened.lookup(d.double(), d.double(), interpolation).dtype == torch.float64

    def test_unknown_interpolation(self, opened: MerlTable):
        up = torch.tensor([0.0, 0.0, 1.0])
        with pytest.raises(ValueError, match="""interpolation must be "nearest" or "linear", got 'cubic'"""):
            opened.lookup(up, up, "cubic")


@given(st.floats(0, pi / 2), st.floats(0, pi / 2), st.floats(-pi, pi))
def test_cell_index_is_the_index_of_merls_own_reader(theta_h: float, theta_d: float, phi_d: float):
    """Formulas of the reader that MERL distributes: square root of theta_h, phi_d modulo pi, all clamped."""
    angles = [torch.tensor(a, dtype=torch.float64) for a in (theta_h, theta_d, phi_d)]
    reduced = phi_d + pi if phi_d < 0 else phi_d
    expected = []
    for coordinate, n in (
        ((theta_h / (pi / 2)) ** 0.5 * 90, 90),
        (theta_d / (pi / 2) * 90, 90),
        (reduced / pi * 180, 180),
    ):
        near = {min(max(int(coordinate + e), 0), n - 1) for e in (-1e-9, 0.0, 1e-9)}
        expected.append(near | ({0} if n == 180 and coordinate > 180 - 1e-9 else set()))
    h, rest = divmod(int(cell_index(*angles)), 90 * 180)
    assert h in expected[0]
    assert rest // 180 in expected[1]
    assert rest % 180 in expected[2]


def test_from_function_tabulates_at_the_centres():
    def f_r(w_i: Tensor, w_o: Tensor) -> Tensor:
        return torch.stack([w_i[..., 2], w_o[..., 2], (w_i * w_o).sum(-1)], dim=-1)

    table = MerlTable.from_function(f_r, "cosines")
    assert table.name == "cosines"
    assert torch.equal(table.valid, above_horizon())
    for h, d, p in visible_cells(100, 13):
        w_i, w_o = centre(h + 0.5, d + 0.5, p + 0.5)
        assert torch.allclose(table.values[h, d, p], f_r(w_i, w_o), atol=1e-12)


def measured_slice(shared_data: Path) -> tuple[Tensor, Tensor]:
    rows = np.loadtxt(shared_data / "merl" / "pink-felt-1d.alta", comments="#")
    return torch.from_numpy(rows[:, 0]), torch.from_numpy(rows[:, 1:])


def test_absolute_scale_against_the_measured_slice_of_pink_felt(shared_data: Path, decoded_pink_felt: MerlTable):
    """w_i = w_o = h, theta_d = 0. The table is a neural encoding, so a few per cent are left; a wrong channel scale
    would show as 15 % in green, 66 % in blue, and 1/pi or a cosine as far more.
    """
    cosine, measured = measured_slice(shared_data)
    keep = cosine > 0.2
    cosine, measured = cosine[keep], measured[keep]
    assert len(cosine) > 50
    w = torch.stack([torch.sqrt(1 - cosine**2), torch.zeros_like(cosine), cosine], dim=-1)
    for interpolation in ("nearest", "linear"):
        ratio = decoded_pink_felt.lookup(w, w, interpolation) / measured
        assert torch.allclose(ratio.mean(0), torch.ones(3).double(), atol=0.05), ratio.mean(0)
        assert float((ratio - 1).abs().mean()) < 0.06
