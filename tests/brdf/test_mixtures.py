"""Libraries of several folders and files, and of libraries: what they take from caches, and what they warn of."""

import os
import warnings
from pathlib import Path

import pytest
import torch

from torchbrdf.brdf import MaterialLibrary, MerlTable
from torchbrdf.brdf.column_sources import MerlSource


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


def opened(*sources: Path) -> MaterialLibrary:
    return MaterialLibrary.from_files(sources, progress=False)


def in_memory(folders: tuple[Path, Path]) -> MaterialLibrary:
    paths = [path for folder in folders for path in sorted(folder.iterdir())]
    return MaterialLibrary.from_tables([MerlTable.open(path) for path in paths])


class TestColumnsOfCaches:
    def test_one_folder_is_the_library_of_that_folder(self, cache: Path, folders: tuple[Path, Path]):
        assert opened(folders[0]).source == MaterialLibrary.from_merl(folders[0], progress=False).source

    def test_a_mixture_is_the_library_of_its_tables(self, cache: Path, folders: tuple[Path, Path]):
        assert opened(*folders).source == in_memory(folders).source

    def test_what_a_cache_holds_is_not_read_again(
        self, cache: Path, folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
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
        assert grown.source == in_memory(folders).source

    def test_a_changed_file_is_read_again(self, cache: Path, folders: tuple[Path, Path]):
        opened(*folders)
        red = MerlTable.open(folders[0] / "red.binary")
        (folders[0] / "red.binary").unlink()
        MerlTable(red.values * 0.7, red.valid).save(folders[0] / "red.binary")
        assert opened(*folders).source == in_memory(folders).source

    def test_the_gram_matrix_of_a_library_that_grew(self, cache: Path, folders: tuple[Path, Path]):
        """By a table with holes, where cells that were shared before no longer are."""
        teal = MerlTable.open(folders[1] / "teal.binary")
        (folders[1] / "teal.binary").unlink()
        holes = torch.rand(90, 90, 180, generator=torch.Generator().manual_seed(0)) < 0.8
        MerlTable(teal.values, teal.valid & holes).save(folders[1] / "teal.binary")
        opened(folders[0])
        assert torch.allclose(opened(*folders).gram, in_memory(folders).gram, rtol=1e-3)  # float16: 2^-11 a factor

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
    def test_of_libraries_in_the_cache(self, cache: Path, folders: tuple[Path, Path]):
        one = opened(folders[0])
        two = opened(folders[0] / "red.binary", folders[1]).without("red")
        both = one + two
        assert both.names == ("red", "white", "teal")
        assert both.stored.mapping is not None
        assert both.source == in_memory(folders).source

    def test_of_libraries_in_memory(self, tiny_tables: dict[str, MerlTable]):
        red, teal = (MaterialLibrary.from_tables([tiny_tables[name]]) for name in ("red", "teal"))
        both = red + teal
        assert both.source == MaterialLibrary.from_tables([tiny_tables["red"], tiny_tables["teal"]]).source

    def test_one_name_in_both_is_refused(self, tiny_tables: dict[str, MerlTable]):
        red = MaterialLibrary.from_tables([tiny_tables["red"]])
        with pytest.raises(ValueError, match=r"both libraries have red; take them out of one with without"):
            red + red


class TestOneMeasurement:
    def test_under_two_names_is_warned_of(self, cache: Path, folders: tuple[Path, Path]):
        red = MerlTable.open(folders[0] / "red.binary")
        MerlTable(red.values * 0.5, red.valid).save(folders[1] / "crimson.binary")
        with pytest.warns(UserWarning, match="red and crimson are one measurement"):
            opened(*folders)

    def test_different_ones_are_not(self, cache: Path, folders: tuple[Path, Path]):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            opened(*folders)


def test_too_few_altogether(folders: tuple[Path, Path]):
    with pytest.raises(ValueError, match="a library needs at least 8 materials, found 3; name more files"):
        opened(*folders)


def test_an_unsound_file_among_many_is_named(cache: Path, folders: tuple[Path, Path]):
    raw = (folders[1] / "teal.binary").read_bytes()
    (folders[1] / "teal.binary").unlink()
    (folders[1] / "teal.binary").write_bytes(raw[:-8])
    with pytest.raises(ValueError, match=r"more.teal\.binary: truncated MERL table"):
        opened(*folders)
    assert not list(cache.glob("libraries/mixture-*/manifest.json"))
