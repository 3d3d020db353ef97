import copy
import hashlib
import json
import os
import pickle
import shutil
import subprocess
import sys
import time
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor

from materials import lambert
from torchbrdf.brdf._library_building import Build
from torchbrdf.brdf.column_sources import MerlSource
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable, above_horizon
from torchbrdf.brdf.merl_directory import MERL_MATERIALS

SHAPE = (90, 90, 180)
FLOAT16_BOUND = 2.0**-11


@pytest.fixture
def fresh_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache for one test."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("TORCHBRDF_CACHE", str(folder))
    return folder


@pytest.fixture
def two_files(merl_directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory of two materials, red and white, that `from_merl` accepts for once: builds take a second."""
    monkeypatch.setattr("torchbrdf.brdf.library.MIN_MATERIALS", 1)
    folder = tmp_path / "materials"
    folder.mkdir()
    for name in ("red", "white"):
        os.link(merl_directory / f"{name}.binary", folder / f"{name}.binary")
    return folder


@pytest.fixture(scope="module")
def converted(merl_directory: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Such a directory, of files of its own, and a cache of its library, which no test changes."""
    folder = tmp_path_factory.mktemp("converted")
    materials = folder / "materials"
    materials.mkdir()
    for name in ("red", "white"):
        shutil.copyfile(merl_directory / f"{name}.binary", materials / f"{name}.binary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchbrdf.brdf.library.MIN_MATERIALS", 1)
        patch.setenv("TORCHBRDF_CACHE", str(folder / "cache"))
        MaterialLibrary.from_merl(materials, progress=False)
    return materials, folder / "cache"


@pytest.fixture
def kept_files(converted: tuple[Path, Path], fresh_cache: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """That directory; `fresh_cache` holds a copy of its cache."""
    monkeypatch.setattr("torchbrdf.brdf.library.MIN_MATERIALS", 1)
    shutil.copytree(converted[1], fresh_cache)
    return converted[0]


def own_copy(path: Path) -> None:
    """In place of a link: times of the file that it is a link to stay."""
    shutil.copyfile(path, path.with_name("copy"))
    path.with_name("copy").replace(path)


ONE_IS_ENOUGH = "import torchbrdf.brdf.library; torchbrdf.brdf.library.MIN_MATERIALS = 1\n"


@pytest.fixture(scope="module")
def merl_library(merl_directory: Path) -> MaterialLibrary:
    return MaterialLibrary.from_merl(merl_directory, progress=False)


def finished(cache: Path) -> list[str]:
    """What in a cache carries a final name."""
    return sorted(p.name for p in cache.rglob("manifest.json") if not p.parent.name.startswith("."))


def relative_error(found: Tensor, expected: Tensor) -> float:
    return float(((found - expected).abs() / expected.abs()).max())


def random_table(name: str, seed: int, decades: float, share: float = 1.0) -> MerlTable:
    """Log-uniform values over some decades; a share of the cells is measured, the others hold NaN."""
    g = torch.Generator().manual_seed(seed)
    values = 10 ** (decades * (torch.rand(*SHAPE, 3, generator=g, dtype=torch.float64) - 0.7))
    valid = torch.rand(SHAPE, generator=g) < share
    return MerlTable(torch.where(valid[..., None], values, torch.nan), valid, name)


@pytest.fixture(scope="module")
def holed_tables() -> list[MerlTable]:
    """a, b and c have different holes, d has none."""
    shares = {"a": 0.7, "b": 0.8, "c": 0.3, "d": 1.0}
    return [random_table(name, seed, 3, share) for seed, (name, share) in enumerate(shares.items())]


@pytest.fixture(scope="module")
def holed_library(holed_tables: list[MerlTable]) -> MaterialLibrary:
    return MaterialLibrary.from_tables(holed_tables)


class TestColumns:
    def test_float16_keeps_the_stated_error_over_seven_decades_whatever_the_scale(self):
        """The bound of library_cache.py: 2^-11 relative down to 2^-25 (7.5 decades) below the largest value.

        Each channel is scaled by itself: a dim one beside a bright one keeps its digits.
        """
        g = torch.Generator().manual_seed(0)
        bright = torch.tensor([2.0**-30, 1.0, 2.0**30], dtype=torch.float64)
        values = bright * torch.exp2(-25 * torch.rand(*SHAPE, 3, generator=g, dtype=torch.float64))
        values[5, 5, 5] = bright * 1.999999
        table = MerlTable(values, torch.ones(SHAPE, dtype=torch.bool), "wide")
        back = MaterialLibrary.from_tables([table]).table("wide")
        for found, expected in zip(back.values.unbind(-1), values.unbind(-1), strict=True):
            assert 0.9 * FLOAT16_BOUND < relative_error(found[back.valid], expected[back.valid]) <= FLOAT16_BOUND

    def test_tables_come_back_with_their_masks(self, holed_tables: list[MerlTable], holed_library: MaterialLibrary):
        for table in holed_tables:
            back = holed_library.table(table.name)
            assert back.name == table.name
            assert torch.equal(back.valid, table.valid)
            assert torch.equal(back.valid, back.valid & above_horizon())
            assert relative_error(back.values[back.valid], table.values[table.valid]) <= FLOAT16_BOUND

    def test_unmeasured_cells_hold_a_measured_neighbour(
        self, holed_tables: list[MerlTable], holed_library: MaterialLibrary
    ):
        """Never zero and never NaN: what the transport reads there is the table's own nearest value."""
        stored = holed_library.stored.columns[:, :3].double() * holed_library.stored.scale[:3]
        assert torch.isfinite(stored).all()
        assert relative_error(stored, holed_tables[0].filled) <= FLOAT16_BOUND

    def test_gram_is_the_plain_sum_over_cells_that_all_measured(
        self, holed_tables: list[MerlTable], holed_library: MaterialLibrary
    ):
        shared = holed_tables[0].valid & holed_tables[1].valid & holed_tables[2].valid
        b = torch.cat([table.values[shared] for table in holed_tables], dim=1)
        expected = b.T @ b
        assert holed_library.gram.dtype == torch.float64
        assert torch.allclose(holed_library.gram, expected, rtol=1e-9)
        rest = [0, 1, 2, *range(6, 12)]
        assert torch.allclose(holed_library.without("b").gram, expected[rest][:, rest], rtol=1e-9)

    def test_black_channel(self):
        values = torch.rand(*SHAPE, 3, dtype=torch.float64)
        values[..., 1] = 0
        back = MaterialLibrary.from_tables([MerlTable(values, torch.ones(SHAPE, dtype=torch.bool), "t")]).table("t")
        assert float(back.values[..., 1].abs().max()) == 0
        assert torch.isfinite(back.values).all()


class TestSelection:
    def test_names_sizes_and_columns(self, tiny_library: MaterialLibrary, tiny_tables: dict[str, MerlTable]):
        assert tiny_library.names == tuple(tiny_tables)
        assert len(tiny_library) == 10
        assert tiny_library.n == 30
        assert "10 materials, n = 30" in repr(tiny_library)

    def test_without(self, tiny_library: MaterialLibrary):
        rest = tiny_library.without("red", "gold-0.3")
        assert rest.names == tuple(n for n in tiny_library.names if n not in ("red", "gold-0.3"))
        assert rest.n == 24
        assert torch.equal(rest.table("copper-0.08").values, tiny_library.table("copper-0.08").values)
        assert rest.source == tiny_library.source
        with pytest.raises(ValueError, match="no material 'red' in this library of 8"):
            rest.table("red")
        assert len(tiny_library) == 10

    def test_subset_keeps_the_order_given(self, tiny_library: MaterialLibrary):
        some = tiny_library.subset(["teal", "white"])
        assert some.names == ("teal", "white")
        assert torch.equal(some.table("white").values, tiny_library.table("white").values)
        swap = [3, 4, 5, 0, 1, 2]
        assert torch.equal(some.gram[swap][:, swap], tiny_library.subset(["white", "teal"]).gram)
        assert some.subset(["white"]).names == ("white",)

    def test_unknown_name_suggests_the_nearest(self, tiny_library: MaterialLibrary):
        expected = r"no material 'gold-0.4' in this library of 10 \(did you mean gold-0.3\?\)"
        for use in (tiny_library.table, tiny_library.without, lambda name: tiny_library.subset([name])):
            with pytest.raises(ValueError, match=expected):
                use("gold-0.4")

    @pytest.mark.parametrize("name", [3, None, 1.5])
    def test_a_name_that_is_no_text(self, tiny_library: MaterialLibrary, name: object):
        for use in (tiny_library.table, tiny_library.without, lambda name: tiny_library.subset([name])):
            with pytest.raises(ValueError, match=rf"^the name of a material must be a text, got {name}$"):
                use(name)

    def test_a_list_in_place_of_names(self, tiny_library: MaterialLibrary):
        message = r"^the name of a material must be a text, got \['red'\]; pass a list's names one by one: \*names$"
        with pytest.raises(ValueError, match=message):
            tiny_library.without(["red"])

    def test_a_selection_of_nothing_is_refused(self, tiny_library: MaterialLibrary):
        with pytest.raises(ValueError, match="at least one"):
            tiny_library.without(*tiny_library.names)
        with pytest.raises(ValueError, match="at least one"):
            tiny_library.subset([])

    def test_a_name_asked_for_twice_is_refused(self, tiny_library: MaterialLibrary):
        with pytest.raises(ValueError, match=r"different names; twice or more: red|twice"):
            tiny_library.subset(["red", "white", "red"])

    def test_from_tables_needs_tables_of_different_names(self, tiny_tables: dict[str, MerlTable]):
        with pytest.raises(ValueError, match="at least one table, got none"):
            MaterialLibrary.from_tables([])
        with pytest.raises(ValueError, match="materials must have different names; twice or more: red"):
            MaterialLibrary.from_tables([tiny_tables["red"], tiny_tables["white"], tiny_tables["red"]])

    def test_source_tells_libraries_apart(self, tiny_tables: dict[str, MerlTable]):
        one, two = tiny_tables["red"], tiny_tables["white"]
        renamed = MerlTable(two.values, two.valid, "whiter")
        brighter = MerlTable(two.values * 1.01, two.valid, "white")
        twice = MerlTable(two.values * 2, two.valid, "white")
        each = ([one, two], [two, one], [two], [renamed], [brighter], [twice])
        sources = [MaterialLibrary.from_tables(tables).source for tables in each]
        assert sources[2] == MaterialLibrary.from_tables([two]).source
        assert len(set(sources)) == 6


class TestCombine:
    def weights(self, n: int, seed: int) -> Tensor:
        return torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)

    def test_is_the_explicit_sum(self, tiny_library: MaterialLibrary, tiny_tables: dict[str, MerlTable]):
        """rho_c = sum_i w_ic b_i over all 30 columns, negative sums cut at zero; in a seventh of the cells."""
        weights = self.weights(30, 0)
        table = tiny_library.combine(weights)
        used = table.valid.ravel()[::7]
        columns = [b.values.reshape(-1, 3)[::7][used] for b in tiny_tables.values()]
        total = torch.zeros(int(used.sum()), 3, dtype=torch.float64)
        size = torch.zeros_like(total)
        for i, b in enumerate(columns):
            for source in range(3):
                for channel in range(3):
                    term = weights[3 * i + source, channel] * b[:, source]
                    total[:, channel] += term
                    size[:, channel] += term.abs()
        assert (total < 0).any()
        found = table.values.reshape(-1, 3)[::7][used]
        assert float(((found - total.clamp_min(0)).abs() / size).max()) < 1.1 * FLOAT16_BOUND
        assert torch.equal(table.valid, above_horizon())

    def test_one_material_alone_is_itself(self, tiny_library: MaterialLibrary):
        for name in ("red", "copper-0.08"):
            weights = torch.zeros(30, 3)
            first = 3 * tiny_library.names.index(name)
            weights[first : first + 3] = torch.eye(3)
            table = tiny_library.combine(weights, "copy")
            assert table.name == "copy"
            expected = tiny_library.table(name).values
            assert torch.allclose(table.values[table.valid].double(), expected[table.valid], rtol=1e-6)

    def test_few_and_many_weights_agree(self, tiny_library: MaterialLibrary):
        """Adding columns of negligible weight must not change the result: two ways to gather."""
        few = torch.zeros(30, 3, dtype=torch.float64)
        few[[2, 17]] = self.weights(2, 1).abs()
        many = few + 1e-13
        valid = above_horizon()
        a, b = tiny_library.combine(few).values[valid], tiny_library.combine(many).values[valid]
        assert torch.allclose(a, b, rtol=1e-5, atol=1e-9)

    @pytest.mark.parametrize("names", [("copper-0.08", "white"), ("copper-0.08", "white", "gold-0.3", "teal")])
    def test_subset_uses_its_own_columns(self, tiny_library: MaterialLibrary, names: tuple[str, ...]):
        """Few columns and many: two ways to gather."""
        weights = self.weights(3 * len(names), 2).abs()
        whole = torch.zeros(30, 3, dtype=torch.float64)
        for i, name in enumerate(names):
            first = 3 * tiny_library.names.index(name)
            whole[first : first + 3] = weights[3 * i : 3 * i + 3]
        valid = above_horizon()
        a, b = tiny_library.subset(names).combine(weights), tiny_library.combine(whole)
        assert torch.allclose(a.values[valid], b.values[valid], rtol=1e-5)

    def test_measured_where_every_material_with_a_weight_is(
        self, holed_tables: list[MerlTable], holed_library: MaterialLibrary
    ):
        weights = torch.zeros(12, 3)
        weights[0, 0] = weights[4, 2] = 0.5
        table = holed_library.combine(weights)
        assert torch.equal(table.valid, holed_tables[0].valid & holed_tables[1].valid)
        assert torch.isfinite(table.values).all()

    def test_wrong_shape(self, tiny_library: MaterialLibrary):
        with pytest.raises(ValueError, match=r"weights must be \(30, 3\) for this library, got \(3, 30\)"):
            tiny_library.combine(torch.zeros(3, 30))

    def test_several_sets_of_weights_are_each_themselves(self, tiny_library: MaterialLibrary):
        few = torch.zeros(30, 3, dtype=torch.float64)
        few[4, 1] = 0.5
        sets = torch.stack([self.weights(30, 3), few])
        for table, weights, name in zip(tiny_library.combine_each(sets, ["a", "b"]), sets, "ab", strict=True):
            alone = tiny_library.combine(weights, name)
            assert table.name == name
            assert torch.equal(table.valid, alone.valid)
            assert torch.allclose(table.values, alone.values, rtol=1e-5, atol=1e-7)

    def test_no_weight_is_black(self, tiny_library: MaterialLibrary):
        """So is the result of a photograph that is below 0 everywhere, under the constraint "nonnegative"."""
        table = tiny_library.combine(torch.zeros(30, 3))
        assert table.measured_share == 1
        assert not table.values.any()
        assert not table.filled.any()
        assert table.values.dtype == tiny_library.combine(self.weights(30, 0)).values.dtype

    def test_no_weights_are_no_tables(self, tiny_library: MaterialLibrary):
        assert tiny_library.combine_each(torch.zeros(0, 30, 3), []) == []

    def test_a_name_for_every_set(self, tiny_library: MaterialLibrary):
        with pytest.raises(ValueError, match=r"must be \(1, 30, 3\) for these names and this library, got \(2,"):
            tiny_library.combine_each(torch.zeros(2, 30, 3), ["a"])

    def test_what_was_not_measured_is_filled_as_the_table_would_be(self, tiny_library: MaterialLibrary):
        table = tiny_library.combine(self.weights(30, 4).abs())
        searched = MerlTable(table.values, table.valid).filled
        assert torch.allclose(table.filled, searched, rtol=1e-6)

    def test_materials_with_different_holes_are_filled_anew(self, holed_library: MaterialLibrary):
        table = holed_library.combine(torch.full((12, 3), 0.1))
        assert torch.equal(table.filled, MerlTable(table.values, table.valid).filled)

    def test_weights_with_a_gradient(self, tiny_library: MaterialLibrary):
        weights = torch.full((30, 3), 0.1, requires_grad=True)
        lost = r"no gradient flows to weights through a table: .* use basis\.render\(weights\)"
        with pytest.warns(UserWarning, match=lost) as caught:
            table = tiny_library.combine(weights)
        assert [warning.filename for warning in caught] == [__file__]
        assert float(table.values.max()) > 0
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with torch.no_grad():
                tiny_library.combine(weights)
            tiny_library.combine(weights.detach())


class TestFromMerl:
    def test_columns_are_the_files(self, merl_library: MaterialLibrary, merl_directory: Path):
        assert merl_library.names == tuple(sorted(path.stem for path in merl_directory.iterdir()))
        for name in merl_library.names[::3]:
            read, back = MerlTable.open(merl_directory / f"{name}.binary"), merl_library.table(name)
            assert torch.equal(read.valid, back.valid)
            used = back.valid[..., None] & (read.values > 2.0**-25 * read.values[read.valid].amax(0))
            assert relative_error(back.values[used], read.values[used]) <= FLOAT16_BOUND

    def test_equals_the_library_of_the_same_tables(self, kept_files: Path):
        tables = [MerlTable.open(kept_files / f"{name}.binary") for name in ("red", "white")]
        expected = MaterialLibrary.from_tables(tables).source
        assert MaterialLibrary.from_merl(kept_files, progress=False).source == expected

    def test_mapped_columns_can_be_given_back_while_they_are_read(self, merl_library: MaterialLibrary):
        assert merl_library.stored.mapping is not None
        weights = torch.randn(1, merl_library.n, 3, generator=torch.Generator().manual_seed(5))
        kept, given_back = (merl_library.combine_each(weights, ["a"], keep=keep)[0] for keep in (True, False))
        assert torch.equal(kept.values, given_back.values)

    def test_reopening_reads_neither_sources_nor_all_columns(
        self, merl_library: MaterialLibrary, merl_directory: Path, monkeypatch: pytest.MonkeyPatch
    ):
        def forbidden(*_: object) -> None:
            pytest.fail("a finished cache was built or read again")

        monkeypatch.setattr(MerlSource, "row", forbidden)
        monkeypatch.setattr(MerlSource, "scan", forbidden)
        again = MaterialLibrary.from_merl(merl_directory, progress=False)
        assert again.source == merl_library.source
        assert torch.equal(again.table("white").values, merl_library.table("white").values)

    @pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc/self/smaps")
    def test_reopened_columns_are_mapped_not_read(self, merl_library: MaterialLibrary, merl_directory: Path):
        """70 MB of columns; after reopening and reading one cell hardly any of them are in memory."""
        again = MaterialLibrary.from_merl(merl_directory, progress=False)
        assert float(again.stored.columns[0, 0]) > 0
        start = again.stored.columns.data_ptr()
        resident = mapped = None
        for line in Path("/proc/self/smaps").read_text().splitlines():
            head = line.split()[0]
            if "-" in head and not head.endswith(":"):
                low, high = (int(part, 16) for part in head.split("-"))
                mapped = low <= start < high
            elif mapped and head == "Rss:":
                resident = int(line.split()[1])
        assert resident is not None
        assert resident < 8_000, f"{resident} kB of 69984 kB are resident"

    def test_what_takes_long_is_said_before_it_begins(
        self, two_files: Path, fresh_cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ):
        own_copy(two_files / "white.binary")
        monkeypatch.setattr("torchbrdf.brdf.library_cache._SECONDS", 8.0)
        MaterialLibrary.from_merl(two_files)
        (folder,) = (path.parent for path in fresh_cache.rglob("manifest.json"))
        expected = f"library of 2 materials: converted once, which takes about 16 s, and kept, 0.0 GB, in {folder}\n"
        assert capsys.readouterr().err == expected
        MaterialLibrary.from_merl(two_files)

        def interrupted(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(Build, "convert", interrupted)  # after what is said
        (two_files / "white.binary").touch()
        one = expected.replace("16 s", "8 s")  # the other is as it was
        for seconds, progress, said in ((8.0, True, one), (8.0, False, ""), (0.2, True, "")):
            monkeypatch.setattr("torchbrdf.brdf.library_cache._SECONDS", seconds)
            with pytest.raises(KeyboardInterrupt):
                MaterialLibrary.from_merl(two_files, progress)
            assert capsys.readouterr().err == said

    def test_a_changed_source_rebuilds(self, two_files: Path, fresh_cache: Path, merl_directory: Path):
        before = MaterialLibrary.from_merl(two_files, progress=False)
        os.remove(two_files / "white.binary")
        os.link(merl_directory / "teal.binary", two_files / "white.binary")
        after = MaterialLibrary.from_merl(two_files, progress=False)
        assert before.source != after.source
        teal = MerlTable.open(two_files / "white.binary")
        assert relative_error(after.table("white").values[teal.valid], teal.values[teal.valid]) <= FLOAT16_BOUND
        assert len(finished(fresh_cache)) == 1

    def test_added_and_removed_materials_rebuild(self, two_files: Path, fresh_cache: Path):
        MaterialLibrary.from_merl(two_files, progress=False)
        os.link(two_files / "red.binary", two_files / "another.binary")
        more = MaterialLibrary.from_merl(two_files, progress=False)
        assert more.names == ("another", "red", "white")
        assert torch.equal(more.table("another").values, more.table("red").values)
        os.remove(two_files / "another.binary")
        assert MaterialLibrary.from_merl(two_files, progress=False).names == ("red", "white")

    def test_directories_of_the_same_name_do_not_share_a_cache(
        self, two_files: Path, fresh_cache: Path, tmp_path: Path
    ):
        other = tmp_path / "elsewhere" / two_files.name
        shutil.copytree(two_files, other, copy_function=os.link)
        os.rename(other / "white.binary", other / "snow.binary")
        assert MaterialLibrary.from_merl(two_files, progress=False).names == ("red", "white")
        assert MaterialLibrary.from_merl(other, progress=False).names == ("red", "snow")
        assert MaterialLibrary.from_merl(two_files, progress=False).names == ("red", "white")
        assert len(finished(fresh_cache)) == 2

    def test_one_folder_down_is_the_same_library(self, two_files: Path, fresh_cache: Path):
        """And what lies beside the tables is no reason to build it again."""
        below = two_files / "brdfs"
        below.mkdir()
        for name in ("red", "white"):
            os.rename(two_files / f"{name}.binary", below / f"{name}.binary")
        first = MaterialLibrary.from_merl(below, progress=False)
        (cached,) = fresh_cache.rglob("columns.f16")
        before = cached.stat()
        (below / "._red.binary").write_bytes(b"\0\5\x16\7")
        assert MaterialLibrary.from_merl(two_files, progress=False).source == first.source
        assert [path.stat() for path in fresh_cache.rglob("columns.f16")] == [before]

    def test_the_folder_and_stamp_of_a_cache_are_those_of_earlier_versions(self, kept_files: Path, fresh_cache: Path):
        """What was built by 0.7 for files that did not change is not built again."""
        states = [(p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in sorted(kept_files.iterdir())]
        key = hashlib.sha256(str(kept_files.resolve()).encode()).hexdigest()[:12]
        folder = fresh_cache / "libraries" / f"{kept_files.name}-{key}"
        manifest = json.loads((folder / "manifest.json").read_text())
        assert manifest["stamp"] == hashlib.sha256(repr(states).encode()).hexdigest()

    def test_a_cache_of_a_table_that_was_taken_unchecked_is_not_used(
        self, two_files: Path, fresh_cache: Path, monkeypatch: pytest.MonkeyPatch
    ):
        """Before 0.8 cells of 1e300 passed."""
        raw = bytearray((two_files / "white.binary").read_bytes())
        raw[12 : 12 + 8] = np.array([1e300]).tobytes()
        os.remove(two_files / "white.binary")
        (two_files / "white.binary").write_bytes(raw)
        with monkeypatch.context() as patch:
            patch.setattr("torchbrdf.brdf.merl.LARGEST", 1e308)
            patch.setattr("torchbrdf.brdf.library_cache.LARGEST", 1e308)
            MaterialLibrary.from_merl(two_files, progress=False)
        with pytest.raises(ValueError, match=r"white\.binary: 1 cells of the table exceed 1e\+11 1/sr"):
            MaterialLibrary.from_merl(two_files, progress=False)

    @pytest.mark.parametrize("file", ["columns.f16", "library.safetensors", "manifest.json"])
    def test_a_damaged_cache_is_rebuilt(
        self, kept_files: Path, fresh_cache: Path, monkeypatch: pytest.MonkeyPatch, file: str
    ):
        """Removed, emptied, cut in half: by a full disk, say, or a clean-up of old files."""
        whole = MaterialLibrary.from_merl(kept_files, progress=False)
        (path,) = fresh_cache.rglob(file)
        raw = path.read_bytes()
        path.unlink()
        with monkeypatch.context() as patch:
            built: list[bool] = []
            patch.setattr(
                "torchbrdf.brdf.library_cache._build_folder", lambda *_: built.append(path.write_bytes(raw) > 0)
            )
            MaterialLibrary.from_merl(kept_files, progress=False)
            path.write_bytes(b"")
            MaterialLibrary.from_merl(kept_files, progress=False)
            MaterialLibrary.from_merl(kept_files, progress=False)
            assert built == [True, True]
        path.write_bytes(raw[: len(raw) // 2])
        again = MaterialLibrary.from_merl(kept_files, progress=False)
        assert again.source == whole.source
        assert torch.equal(again.gram, whole.gram)
        assert path.read_bytes() == raw

    @pytest.mark.parametrize("format", [2, None])
    def test_a_cache_of_another_version_is_rebuilt(self, kept_files: Path, fresh_cache: Path, format: int | None):
        """Whose columns may mean something else."""
        (path,) = fresh_cache.rglob("manifest.json")
        whole = path.read_text()
        path.write_text(json.dumps(json.loads(whole) | {"format": format}))
        columns = path.with_name("columns.f16")
        expected = columns.read_bytes()
        columns.write_bytes(bytes(len(expected)))
        MaterialLibrary.from_merl(kept_files, progress=False)
        assert path.read_text() == whole
        assert columns.read_bytes() == expected

    @pytest.mark.parametrize(("stage", "at"), [("scan", 2), ("row", 60)])
    def test_an_interrupted_build_leaves_nothing_that_looks_finished(
        self, two_files: Path, fresh_cache: Path, monkeypatch: pytest.MonkeyPatch, stage: str, at: int
    ):
        calls = 0
        original = getattr(MerlSource, stage)

        def interrupted(self: MerlSource, i: int):
            nonlocal calls
            calls += 1
            if calls == at:
                raise KeyboardInterrupt
            return original(self, i)

        with monkeypatch.context() as patch:
            patch.setattr(MerlSource, stage, interrupted)
            with pytest.raises(KeyboardInterrupt):
                MaterialLibrary.from_merl(two_files, progress=False)
        assert calls == at
        assert finished(fresh_cache) == []
        assert not [p for p in fresh_cache.rglob("*") if p.is_file() and p.stat().st_size > 0]
        assert MaterialLibrary.from_merl(two_files, progress=False).names == ("red", "white")

    def test_an_interrupted_rebuild_is_noticed_too(
        self, two_files: Path, fresh_cache: Path, monkeypatch: pytest.MonkeyPatch
    ):
        """The old cache may stay, but it must not pass for the new one."""
        MaterialLibrary.from_merl(two_files, progress=False)
        os.rename(two_files / "white.binary", two_files / "snow.binary")

        def interrupted(*_: object) -> None:
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(MerlSource, "row", interrupted)
            with pytest.raises(KeyboardInterrupt):
                MaterialLibrary.from_merl(two_files, progress=False)
        assert MaterialLibrary.from_merl(two_files, progress=False).names == ("red", "snow")

    def test_a_killed_build_leaves_nothing_that_looks_finished_and_is_cleared_away(
        self, two_files: Path, fresh_cache: Path
    ):
        """No `finally` runs in a process that is killed."""
        code = ONE_IS_ENOUGH + (
            "import os, sys; from torchbrdf.brdf import _library_building, MaterialLibrary\n"
            "_library_building.fill = lambda *_: os._exit(9)\n"
            "MaterialLibrary.from_merl(sys.argv[1], progress=False)"
        )
        ran = subprocess.run([sys.executable, "-c", code, str(two_files)], capture_output=True)
        assert ran.returncode == 9, ran.stderr
        assert list(fresh_cache.rglob("*.f16")), "the process was killed before it wrote anything"
        assert finished(fresh_cache) == []
        assert MaterialLibrary.from_merl(two_files, progress=False).names == ("red", "white")
        assert len(list(fresh_cache.rglob("*.f16"))) == 1

    def test_no_room(self, two_files: Path, fresh_cache: Path, monkeypatch: pytest.MonkeyPatch):
        """Two materials take 2 x 3 x 1,458,000 values of two bytes, and a twentieth more while they are written."""
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=10_000_000))
        with pytest.raises(OSError, match="make room") as caught:
            MaterialLibrary.from_merl(two_files, progress=False)
        where, said = str(caught.value).split(": ", 1)
        assert Path(where).is_relative_to(fresh_cache)
        assert said == (
            "the library cache needs 0.02 GB, 0.01 GB are free; make room or set TORCHBRDF_CACHE to another disk"
        )
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=18_370_000))
        with pytest.raises(OSError, match="make room"):
            MaterialLibrary.from_merl(two_files, progress=False)
        assert finished(fresh_cache) == []
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=18_371_000))
        assert MaterialLibrary.from_merl(two_files, progress=False).names == ("red", "white")

    def test_two_processes_at_once(
        self, two_files: Path, fresh_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        """Another one and this start building when both are ready; both must end with the same whole library."""
        code = ONE_IS_ENOUGH + (
            "import json, sys, time; from pathlib import Path\n"
            "from torchbrdf.brdf import MaterialLibrary, column_sources\n"
            "rows = 0; row = column_sources.MerlSource.row\n"
            "def counted(self, i):\n"
            "    global rows; rows += 1; time.sleep(0.005); return row(self, i)\n"
            "column_sources.MerlSource.row = counted\n"
            "(Path(sys.argv[2]) / 'other').touch()\n"
            "while not (Path(sys.argv[2]) / 'this').exists(): time.sleep(0.001)\n"
            "library = MaterialLibrary.from_merl(sys.argv[1], progress=False)\n"
            "print(json.dumps([library.source, rows, float(library.stored.columns.double().sum())]))"
        )
        rows, row = 0, MerlSource.row

        def counted(self: MerlSource, i: int):
            nonlocal rows
            rows += 1
            time.sleep(0.005)
            return row(self, i)

        monkeypatch.setattr(MerlSource, "row", counted)
        ready = tmp_path / "ready"
        ready.mkdir()
        command = [sys.executable, "-c", code, str(two_files), str(ready)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as other:
            while not (ready / "other").exists():
                assert other.poll() is None, other.stderr.read()
                time.sleep(0.001)
            (ready / "this").touch()
            opened = MaterialLibrary.from_merl(two_files, progress=False)
            out, error = other.communicate(timeout=100)
        assert other.returncode == 0, error
        source, others, total = json.loads(out)
        assert source == opened.source
        assert total == float(opened.stored.columns.double().sum())
        assert sorted([rows, others]) in ([0, 90], [90, 90]), "each row is read by one of them, or by both alone"

    def test_empty_and_absent_directories(self, tmp_path: Path):
        with pytest.raises(ValueError, match=r"holds no materials; expected MERL \*\.binary files"):
            MaterialLibrary.from_merl(tmp_path)
        with pytest.raises(FileNotFoundError, match="gone: no such directory"):
            MaterialLibrary.from_merl(tmp_path / "gone")

    def test_fewer_than_eight_materials(self, linked_merl: Path):
        os.remove(linked_merl / "red.binary")
        with pytest.raises(ValueError, match="a library needs at least 8 materials, found 7; add MERL"):
            MaterialLibrary.from_merl(linked_merl)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda raw: raw[:-8], r"red\.binary: truncated MERL table"),
            (lambda raw: raw + b"\0", r"red\.binary: oversized MERL table"),
            (lambda raw: b"\xb4" + raw[1:], r"red\.binary: not a MERL table"),
            (lambda raw: raw[:12] + b"\xff" * 8 + raw[20:], r"red\.binary: .*1 cells of the table are NaN"),
            (lambda raw: raw[:12] + b"\0\0\0\0\0\0\xf0\xbf" * 4374000, r"red\.binary: .*measured"),
        ],
        ids=["truncated", "oversized", "header", "nan", "nothing-measured"],
    )
    def test_an_unsound_file_is_named(self, two_files: Path, fresh_cache: Path, change, message: str):
        raw = (two_files / "red.binary").read_bytes()
        os.remove(two_files / "red.binary")
        (two_files / "red.binary").write_bytes(change(raw))
        with pytest.raises(ValueError, match=message) as caught:
            MaterialLibrary.from_merl(two_files, progress=False)
        assert "\n" not in str(caught.value)
        assert finished(fresh_cache) == []


class TestDefault:
    def test_has_the_hundred_materials_of_merl_and_sixteen_more(self, default_library: MaterialLibrary):
        assert set(default_library.names) > set(MERL_MATERIALS)
        assert default_library.n == 348

    def test_every_column_is_finite_and_not_negative(self, default_library: MaterialLibrary):
        columns = default_library.stored.columns
        bits = columns.view(torch.int16)  # of a float16 >= 0 and finite: sign 0, exponent below 31
        assert int(bits.min()) >= 0
        assert int(bits.max()) < 0x7C00
        assert torch.isfinite(default_library.gram).all()

    def test_a_diffuse_and_a_mirror_like_material_are_so(self, default_library: MaterialLibrary):
        """f_r in the mirror direction against 60 degrees away from it, incidence at 30 degrees."""
        a = torch.tensor([torch.pi / 6, -torch.pi / 6, torch.pi / 6 - torch.pi / 3 * 2])
        d = torch.stack([torch.sin(a), torch.zeros(3), torch.cos(a)], dim=-1)
        d[2] = torch.tensor([0.0, 0.0, 1.0])
        contrast = {}
        for name in ("white-diffuse-bball", "chrome"):
            f_r = default_library.table(name).lookup(d[:1], d[1:])
            contrast[name] = float((f_r[0] / f_r[1]).mean())
        assert 0.5 < contrast["white-diffuse-bball"] < 3
        assert contrast["chrome"] > 100

    def test_embedded_file_is_small(self):
        import torchbrdf

        size = (Path(torchbrdf.__file__).parent / "brdf" / "default_library.safetensors").stat().st_size
        assert size <= 6_000_000


class TestCopies:
    def test_a_deep_copy_shares_the_mapped_columns(self, kept_files: Path) -> None:
        library = MaterialLibrary.from_merl(kept_files, progress=False)
        copied = copy.deepcopy(library)
        assert copied.names == library.names
        assert copied.stored is library.stored
        assert copied.stored.mapping is not None

    def test_a_pickle_of_a_mapped_library_says_where_it_lies(self, kept_files: Path, fresh_cache: Path) -> None:
        library = MaterialLibrary.from_merl(kept_files, progress=False)
        stored = pickle.dumps(library)
        assert len(stored) < 4096
        found = pickle.loads(stored)
        assert found.names == library.names
        assert found.stored.mapping is not None
        assert torch.equal(found.stored.columns, library.stored.columns)
        (manifest,) = fresh_cache.rglob("manifest.json")
        other = json.loads(manifest.read_text()) | {"fingerprint": "another"}
        manifest.write_text(json.dumps(other))
        with pytest.raises(ValueError, match=r": the cache of a pickled library holds another library by now; open "):
            pickle.loads(stored)
        manifest.unlink()
        with pytest.raises(ValueError, match=r": the cache of a pickled library is gone; open the library anew"):
            pickle.loads(stored)

    def test_a_pickle_of_tables_in_memory_holds_them(self) -> None:
        library = MaterialLibrary.from_tables([MerlTable.from_function(lambert(0.5, 0.5, 0.5), "grey")])
        found = pickle.loads(pickle.dumps(library))
        assert torch.equal(found.stored.columns, library.stored.columns)
