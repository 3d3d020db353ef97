"""Libraries of several folders and files, and of libraries: what they take from caches, and what they warn of."""

import json
import os
import re
import shutil
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest
import torch

from torchbrdf.brdf import MaterialLibrary, MerlTable
from torchbrdf.brdf.column_sources import MerlSource, TableSource
from torchbrdf.brdf.library_cache import open_or_build
from torchbrdf.brdf.rgl import RGLMaterial
from torchbrdf.brdf.rgl_table import Tabulated, tabulate


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Empty; three materials are enough."""
    monkeypatch.setattr("torchbrdf.brdf.library.MIN_MATERIALS", 2)
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def folders(merl_directory: Path, tmp_path: Path) -> tuple[Path, Path]:
    """`own` holds red and white, `more` holds teal."""
    for folder, names in (("own", ("red", "white")), ("more", ("teal",))):
        (tmp_path / folder).mkdir()
        for name in names:
            os.link(merl_directory / f"{name}.binary", tmp_path / folder / f"{name}.binary")
    return tmp_path / "own", tmp_path / "more"


def opened(*sources: Path | str) -> MaterialLibrary:
    return MaterialLibrary.from_files(sources, progress=False)


def replaced(path: Path, factor: float) -> None:
    """A table by one of another scale; links to it stay as they were."""
    table = MerlTable.open(path)
    path.unlink()
    MerlTable(table.values * factor, table.valid).save(path)


def in_memory(folders: tuple[Path, Path]) -> MaterialLibrary:
    paths = [path for folder in folders for path in sorted(folder.iterdir())]
    return MaterialLibrary.from_tables([MerlTable.open(path) for path in paths])


@pytest.fixture(scope="module")
def whole(merl_directory: Path) -> MaterialLibrary:
    """Of the tables of `folders`."""
    tables = [MerlTable.open(merl_directory / f"{name}.binary") for name in ("red", "white", "teal")]
    return MaterialLibrary.from_tables(tables)


@pytest.fixture(scope="module")
def tabulated_once() -> Iterator[None]:
    """A material of the RGL database is put on MERL's grid once, which takes two seconds."""
    found: dict[str, Tabulated] = {}

    def kept(material: RGLMaterial) -> Tabulated:
        if material.name not in found:
            found[material.name] = tabulate(material)
        return found[material.name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchbrdf.brdf.rgl_table.tabulate", kept)
        yield


class TestColumnsOfCaches:
    def test_one_folder_is_the_library_of_that_folder(self, cache: Path, folders: tuple[Path, Path]):
        assert opened(folders[0]).source == MaterialLibrary.from_merl(folders[0], progress=False).source

    def test_a_mixture_is_the_library_of_its_tables(
        self, cache: Path, folders: tuple[Path, Path], whole: MaterialLibrary
    ):
        assert opened(*folders).source == whole.source

    def test_what_a_cache_holds_is_not_read_again(
        self, cache: Path, folders: tuple[Path, Path], whole: MaterialLibrary, monkeypatch: pytest.MonkeyPatch
    ):
        opened(folders[0])
        read: list[str] = []
        scan = MerlSource.scan

        def noted(self: MerlSource, material: int):
            read.append(self.names[material])
            return scan(self, material)

        monkeypatch.setattr(MerlSource, "scan", noted)
        grown = opened(*folders)
        assert read == ["teal"]
        assert grown.source == whole.source

    def test_nothing_is_taken_where_nothing_shall_be(self, cache: Path, tiny_tables: dict[str, MerlTable]):
        source = TableSource([tiny_tables["red"]])
        (cache / "libraries").mkdir(parents=True)
        for name, known, parts in (("a", (), 0), ("b", (), 1), ("c", None, 0)):
            stored = open_or_build(source, cache / "libraries" / name, False, known)
            assert len(stored.parts) == parts, name

    def test_a_changed_file_is_read_again(self, cache: Path, folders: tuple[Path, Path]):
        opened(*folders)
        replaced(folders[0] / "red.binary", 0.7)
        assert opened(*folders).source == in_memory(folders).source

    def test_the_gram_matrix_of_a_library_that_grew(self, cache: Path, folders: tuple[Path, Path]):
        """By a table with holes, where cells that were shared before no longer are."""
        teal = MerlTable.open(folders[1] / "teal.binary")
        (folders[1] / "teal.binary").unlink()
        holes = torch.rand(90, 90, 180, generator=torch.Generator().manual_seed(0)) < 0.8
        MerlTable(teal.values, teal.valid & holes).save(folders[1] / "teal.binary")
        opened(folders[0])
        assert torch.allclose(opened(*folders).gram, in_memory(folders).gram, rtol=1e-3)  # float16: 2^-11 a factor

    def test_the_gram_matrix_of_what_two_caches_hold_and_of_what_is_new(
        self, cache: Path, folders: tuple[Path, Path], merl_directory: Path, monkeypatch: pytest.MonkeyPatch
    ):
        monkeypatch.setattr("torchbrdf.brdf.library.MIN_MATERIALS", 1)
        for folder in folders:
            opened(folder)
        gold = merl_directory / "gold-0.3.binary"
        library = opened(*folders, gold)
        assert [part.mine for part in library.stored.parts] == [(0, 1), (2,), (3,)]
        paths = [path for folder in folders for path in sorted(folder.iterdir())]
        anew = MaterialLibrary.from_tables([MerlTable.open(path) for path in (*paths, gold)])
        assert library.source == anew.source
        assert torch.allclose(library.gram, anew.gram, rtol=1e-3)  # float16: 2^-11 a factor

    def test_parts_say_what_came_from_where(self, cache: Path, folders: tuple[Path, Path]):
        before = opened(folders[0])
        parts = opened(*folders).stored.parts
        assert [part.mine for part in parts] == [(0, 1), (2,)]
        assert parts[0].fingerprint == before.source
        assert before.stored.parts == ()

    def test_mixtures_opened_longest_ago_go(
        self, cache: Path, folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
    ):
        monkeypatch.setattr("torchbrdf.brdf.library_cache._KEPT_MIXTURES", 1)
        opened(*folders)
        opened(folders[0] / "red.binary", folders[1])
        assert len(list(cache.glob("libraries/mixture-*/manifest.json"))) == 1
        assert opened(*folders).names == ("red", "white", "teal")


class TestSum:
    def test_of_libraries_in_the_cache(self, cache: Path, folders: tuple[Path, Path], whole: MaterialLibrary):
        one = opened(folders[0])
        two = opened(folders[0] / "red.binary", folders[1]).without("red")
        both = one + two
        assert both.names == ("red", "white", "teal")
        assert both.stored.mapping is not None
        assert both.source == whole.source

    def test_of_libraries_in_memory(self, tiny_tables: dict[str, MerlTable]):
        red, teal = (MaterialLibrary.from_tables([tiny_tables[name]]) for name in ("red", "teal"))
        both = red + teal
        assert both.source == MaterialLibrary.from_tables([tiny_tables["red"], tiny_tables["teal"]]).source

    def test_of_one_file_under_two_names(self, cache: Path, folders: tuple[Path, Path], merl_directory: Path):
        """Whose columns are copied to both."""
        os.link(merl_directory / "red.binary", folders[1] / "red.binary")
        with pytest.warns(UserWarning, match="own/red and more/red"):
            whole = opened(*folders)
        apart, short = whole.subset(["own/red", "teal"]), opened(folders[0]).subset(["red"])
        both = apart + short
        assert both.names == ("own/red", "teal", "red")
        assert torch.equal(both.table("own/red").values, both.table("red").values)

    def test_one_name_in_both_is_refused(self, tiny_tables: dict[str, MerlTable]):
        red = MaterialLibrary.from_tables([tiny_tables["red"]])
        with pytest.raises(ValueError, match=r"both libraries have red; take them out of one with without"):
            red + red


class TestWarnings:
    """Whenever a library is opened, not on the day on which it is built alone."""

    def test_one_measurement_under_two_names(self, cache: Path, folders: tuple[Path, Path]):
        red = MerlTable.open(folders[0] / "red.binary")
        MerlTable(red.values * 0.5, red.valid).save(folders[1] / "crimson.binary")
        for _ in range(2):
            with pytest.warns(UserWarning, match="twice in this library, where it counts twice: red and crimson; "):
                opened(*folders)

    def test_one_measurement_of_which_one_is_left_out(self, cache: Path, folders: tuple[Path, Path]):
        red = MerlTable.open(folders[0] / "red.binary")
        MerlTable(red.values * 0.5, red.valid).save(folders[1] / "crimson.binary")
        with pytest.warns(UserWarning, match=r"^red is left out, but crimson is the same measurement and stays; leave"):
            MaterialLibrary.from_files(folders, progress=False, without=["red"])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            MaterialLibrary.from_files(folders, progress=False, without=["red", "crimson"])

    def test_a_table_that_reflects_six_times_what_it_gets(self, cache: Path, folders: tuple[Path, Path]):
        """Of a folder, of a mixture that takes it from the folder's cache, and of one that is there already."""
        replaced(folders[0] / "white.binary", 7.5)
        for given in (folders[:1], folders, folders):
            with pytest.warns(UserWarning, match=r"^white: reflects 6\.00 times the light that comes in at .*; is it"):
                opened(*given)

    def test_a_cache_of_before_0_11_says_it_too(self, cache: Path, folders: tuple[Path, Path]):
        replaced(folders[0] / "white.binary", 7.5)
        with pytest.warns(UserWarning, match="reflects"):
            before = opened(folders[0])
        (path,) = cache.rglob("manifest.json")
        manifest = json.loads(path.read_text())
        for key in ("said", "same", "stamps", "parts"):
            del manifest[key]
        path.write_text(json.dumps(manifest))
        for _ in range(2):
            with pytest.warns(UserWarning, match="white: reflects 6.00 times"):
                assert opened(folders[0]).source == before.source

    def test_colours_outside_rec_709(
        self, cache: Path, folders: tuple[Path, Path], shared_data: Path, tabulated_once: None
    ):
        said = r"^vch_silk_blue_rgb: 23% of its cells have colours outside Rec\. 709"
        for _ in range(2):
            with pytest.warns(UserWarning, match=said):
                opened(folders[0], shared_data / "rgl_more" / "vch_silk_blue_rgb.bsdf")

    def test_sound_tables_pass_without_a_word(self, cache: Path, folders: tuple[Path, Path]):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            opened(*folders)


class TestKinds:
    @pytest.mark.filterwarnings("ignore:.*have colours outside")
    def test_rgl_tables_join(self, cache: Path, folders: tuple[Path, Path], shared_data: Path, tabulated_once: None):
        path = shared_data / "rgl_more" / "vch_silk_blue_rgb.bsdf"
        expected = MerlTable.from_bsdf(path)
        found = opened(folders[0], path).table(path.stem)
        assert torch.equal(found.valid, expected.valid)
        assert torch.allclose(found.values[found.valid].float(), expected.values[found.valid], rtol=5e-4, atol=1e-6)

    def test_the_embedded_library_joins(
        self, cache: Path, folders: tuple[Path, Path], default_library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch
    ):
        two = MaterialLibrary.from_tables([default_library.table(name) for name in ("brass", "red-fabric")])
        two = replace(two, stored=replace(two.stored, stamps=("of brass", "of red-fabric")))
        monkeypatch.setattr(MaterialLibrary, "default", classmethod(lambda *_: two))
        os.rename(folders[1] / "teal.binary", folders[1] / "brass.binary")
        library = opened("default", *folders)
        assert library.names == ("default/brass", "red-fabric", "red", "white", "more/brass")
        assert torch.equal(library.table("default/brass").values, two.table("brass").values)

    def test_a_table_of_few_measured_cells(self, cache: Path, folders: tuple[Path, Path]):
        table = MerlTable.open(folders[0] / "red.binary")
        table.valid[30:] = False
        (folders[0] / "red.binary").unlink()
        table.save(folders[0] / "red.binary")
        with pytest.warns(UserWarning, match=r"^red: 57% of its cells were not measured; .* leave it out$"):
            opened(*folders)

    @pytest.mark.filterwarnings("error")
    def test_what_is_left_out_is_not_warned_of(self, cache: Path, folders: tuple[Path, Path]):
        replaced(folders[0] / "white.binary", 6)
        library = MaterialLibrary.from_files(folders, progress=False, without=["white"])
        assert library.names == ("red", "teal")

    def test_tables_without_a_common_cell(self, cache: Path, folders: tuple[Path, Path]):
        for name, rows in (("red", slice(0, 40)), ("white", slice(40, 90))):
            path = folders[0] / f"{name}.binary"
            table = MerlTable.open(path)
            table.valid[rows] = False
            path.unlink()
            table.save(path)
        with pytest.raises(ValueError, match=r"^no cell was measured in all of these 2 .*; \w+ measured fewest"):
            opened(folders[0])
        assert list((cache / "libraries").iterdir()) == []

    def test_holes_of_what_is_left_out_cut_no_cells(
        self, cache: Path, folders: tuple[Path, Path], whole: MaterialLibrary
    ):
        path = folders[0] / "red.binary"
        table = MerlTable.open(path)
        table.valid[40:] = False
        path.unlink()
        table.save(path)
        kept = MaterialLibrary.from_files(folders, progress=False, without=["red"])
        torch.testing.assert_close(kept.gram, whole.subset(["white", "teal"]).gram, rtol=1e-3, atol=0)

    def test_a_small_hole_makes_no_second_cache(self, cache: Path, folders: tuple[Path, Path]):
        kept = MaterialLibrary.from_files(folders, progress=False, without=["red"])
        assert kept.source == opened(*folders).source

    def test_a_table_of_zeros(self, cache: Path, folders: tuple[Path, Path]):
        replaced(folders[0] / "red.binary", 0)
        with pytest.warns(UserWarning, match=r"^red: reflects nothing: f_r is 0 "):
            opened(*folders)

    def test_a_name_without_its_folder(self, cache: Path, folders: tuple[Path, Path], merl_directory: Path):
        os.link(merl_directory / "gold-0.3.binary", folders[1] / "red.binary")
        with pytest.raises(ValueError, match=r"^no material 'red' in .* \(did you mean own/red or more/red\?\)$"):
            opened(*folders).without("red")

    def test_a_path_that_is_empty(self, cache: Path, folders: tuple[Path, Path]):
        with pytest.raises(ValueError, match=r'^one of the paths of the library is empty; "\." is the current folder$'):
            opened(folders[0], "")

    def test_a_file_of_the_rgl_database_that_is_embedded(
        self, cache: Path, folders: tuple[Path, Path], merl_directory: Path, monkeypatch: pytest.MonkeyPatch
    ):
        """Told by its name, however unlike its table is."""
        leaf = replace(MerlTable.open(folders[0] / "white.binary"), name="leaf_maple")
        embedded = MaterialLibrary.from_tables([leaf])
        embedded = replace(embedded, stored=replace(embedded.stored, stamps=("leaf_maple",)))
        monkeypatch.setattr(MaterialLibrary, "default", classmethod(lambda *_: embedded))
        os.rename(folders[1] / "teal.binary", folders[1] / "leaf_maple_rgb.binary")
        with pytest.warns(UserWarning, match="where it counts twice: leaf_maple and leaf_maple_rgb; leave one out"):
            opened("default", folders[1])

    @pytest.mark.filterwarnings("error")
    def test_embedded_materials_that_look_alike_are_no_mistake(
        self, cache: Path, folders: tuple[Path, Path], default_library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch
    ):
        names = ("irid_flake_paint1", "irid_flake_paint1_fine")
        two = MaterialLibrary.from_tables([default_library.table(name) for name in names])
        assert two.stored.same == ((0, 1),)
        two = replace(two, stored=replace(two.stored, stamps=names))
        monkeypatch.setattr(MaterialLibrary, "default", classmethod(lambda *_: two))
        assert MaterialLibrary.from_files(["default", folders[0]], progress=False).stored.same == ((0, 1),)

    def test_one_name_in_two_folders(self, cache: Path, folders: tuple[Path, Path], merl_directory: Path):
        os.link(merl_directory / "gold-0.3.binary", folders[1] / "red.binary")
        library = opened(*folders)
        assert library.names == ("own/red", "white", "more/red", "teal")
        gold = MerlTable.open(merl_directory / "gold-0.3.binary")
        found = library.table("more/red")
        assert torch.allclose(found.values[gold.valid], gold.values[gold.valid], rtol=5e-4)

    def test_leaving_out_and_combining(self, cache: Path, folders: tuple[Path, Path]):
        library = opened(*folders).without("white")
        weights = torch.zeros(6, 3)
        weights[3:] = torch.eye(3)
        expected = MerlTable.open(folders[1] / "teal.binary")
        table = library.combine(weights)
        assert torch.equal(table.valid, expected.valid)
        assert torch.allclose(table.values[table.valid].double(), expected.values[table.valid], rtol=5e-4)


def write_empty(path: Path) -> None:
    path.write_bytes(b"")


def write_truncated(path: Path) -> None:
    path.write_bytes(np.array([90, 90, 180], "<i4").tobytes() + bytes(1000))


def write_no_tensors(path: Path) -> None:
    path.write_bytes(b"tensor_file\0\1\0")


def link_to_nothing(path: Path) -> None:
    path.symlink_to("gone.binary")


@pytest.mark.parametrize(
    ("make", "name", "said"),
    [
        (write_empty, "bad.binary", r"is empty \(0 bytes\)"),
        (write_truncated, "bad.binary", "truncated MERL table"),
        (write_empty, "bad.bsdf", r"is empty \(0 bytes\)"),
        (write_no_tensors, "bad.bsdf", ""),
        (write_truncated, "bad.bsdf", ""),
        (link_to_nothing, "bad.binary", r"a link to gone\.binary, which does not exist"),
        (Path.mkdir, "bad.binary", "is a folder"),
    ],
)
class TestBadFiles:
    def test_in_a_folder(
        self, cache: Path, folders: tuple[Path, Path], make: Callable[[Path], None], name: str, said: str
    ):
        make(folders[1] / name)
        with pytest.raises((OSError, ValueError), match=rf"more.{re.escape(name)}: {said}") as raised:
            opened(*folders)
        assert "\n" not in str(raised.value)
        assert not list(cache.rglob("manifest.json"))


def test_without_bad_files_it_is_the_library_again(cache: Path, folders: tuple[Path, Path]):
    for make, name in ((write_truncated, "bad.binary"), (write_no_tensors, "bad.bsdf"), (Path.mkdir, "bad.binary")):
        bad = folders[1] / name
        make(bad)
        with pytest.raises((OSError, ValueError)):
            opened(*folders)
        bad.rmdir() if bad.is_dir() else bad.unlink()
    assert opened(*folders).names == ("red", "white", "teal")


class TestBetweenRuns:
    def test_a_file_that_vanished(self, cache: Path, folders: tuple[Path, Path]):
        given = (folders[0], folders[1] / "teal.binary")
        opened(*given)
        given[1].unlink()
        with pytest.raises(FileNotFoundError, match=r"teal\.binary: no such file; expected a measured table"):
            opened(*given)

    def test_a_file_that_vanished_from_a_folder(self, cache: Path, folders: tuple[Path, Path]):
        opened(*folders)
        (folders[0] / "red.binary").unlink()
        assert opened(*folders).names == ("white", "teal")

    def test_a_file_that_changes_while_it_is_read(
        self, cache: Path, folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
    ):
        row, teal = MerlSource.row, folders[1] / "teal.binary"
        shutil.copyfile(teal, folders[1] / "copy")  # times of the file that it is a link to stay
        (folders[1] / "copy").replace(teal)

        def disturbed(self: MerlSource, i: int):
            if i == 60:
                os.utime(teal, ns=(1, 1))
            return row(self, i)

        monkeypatch.setattr(MerlSource, "row", disturbed)
        with pytest.raises(ValueError, match="a file of the library changed while it was read; run this again"):
            opened(*folders)
        assert not list(cache.rglob("manifest.json"))

    def test_an_interrupted_mixture_leaves_its_parts(
        self, cache: Path, folders: tuple[Path, Path], whole: MaterialLibrary, monkeypatch: pytest.MonkeyPatch
    ):
        before = opened(folders[0])

        def interrupted(*_: object) -> None:
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(MerlSource, "row", interrupted)
            with pytest.raises(KeyboardInterrupt):
                opened(*folders)
        assert len(list(cache.rglob("columns.f16"))) == 1
        assert opened(folders[0]).source == before.source
        assert opened(*folders).source == whole.source

    def test_what_killed_builds_of_other_mixtures_left_goes(self, cache: Path, folders: tuple[Path, Path]):
        left = cache / "libraries" / ".mixture-0123456789ab.89abcdef"
        left.mkdir(parents=True)
        (left / "columns.f16").write_bytes(b"half")
        opened(*folders)
        assert not left.exists()

    def test_a_cache_that_another_process_builds_is_left_alone(self, cache: Path, folders: tuple[Path, Path]):
        from filelock import FileLock

        opened(folders[0])
        (lock,) = cache.rglob("*.lock")
        with FileLock(lock):
            assert opened(*folders).stored.parts == ()

    def test_two_at_once(
        self, cache: Path, folders: tuple[Path, Path], whole: MaterialLibrary, monkeypatch: pytest.MonkeyPatch
    ):
        """Both start when both are ready; both end with the same whole library, which one of them made."""
        ready, rows, row = Barrier(2), list[int](), MerlSource.row

        def noted(self: MerlSource, i: int):
            rows.append(i)
            return row(self, i)

        def one(_: int) -> str:
            ready.wait(60)
            return opened(*folders).source

        monkeypatch.setattr(MerlSource, "row", noted)
        with ThreadPoolExecutor(2) as pool:
            sources = set(pool.map(one, range(2)))
        assert rows == list(range(90))
        assert sources == {whole.source}


def test_too_few_altogether(folders: tuple[Path, Path]):
    with pytest.raises(ValueError, match="a library needs at least 8 materials, found 3; add MERL"):
        opened(*folders)


def test_an_unsound_file_among_many_is_named(cache: Path, folders: tuple[Path, Path]):
    raw = (folders[1] / "teal.binary").read_bytes()
    (folders[1] / "teal.binary").unlink()
    (folders[1] / "teal.binary").write_bytes(raw[:-8])
    with pytest.raises(ValueError, match=r"more.teal\.binary: truncated MERL table"):
        opened(*folders)
    assert not list(cache.glob("libraries/mixture-*/manifest.json"))
