"""The precomputed transport on disk: written once, damaged, interrupted, out of room; which backend "auto" takes.

The grid is far too coarse for right images; the one at work everywhere else takes minutes to build so often.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from coarse_grids import COARSE
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.files import FullDiskError
from torchbrdf.lasting import LastFew
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.transport.harmonic import cache as harmonic_cache
from torchbrdf.transport.harmonic.cache import is_precomputed, transport_of
from torchbrdf.transport.harmonic.transport import HarmonicTransport
from torchbrdf.view.sphere import SphereView

PROBE = LightProbe(torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(0)))
VIEW = SphereView(12)


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A grid that is built in a moment, an empty cache, and nothing in memory."""
    for name, value in COARSE.items():
        monkeypatch.setattr(name, value)
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(harmonic_cache, "_in_memory", LastFew(2))


@pytest.fixture(scope="module")
def materials(merl_directory: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("materials")
    for name in ("red", "satin-0.5"):
        os.link(merl_directory / f"{name}.binary", folder / f"{name}.binary")
    return folder


@pytest.fixture(scope="module")
def library(materials: Path) -> MaterialLibrary:
    """Itself in the session's cache; its transport goes to the cache of each test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchbrdf.brdf.library.MIN_MATERIALS", 1)
        return MaterialLibrary.from_merl(materials, progress=False)


@pytest.fixture
def forget(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Start as another process would: nothing in memory."""
    return lambda: monkeypatch.setattr(harmonic_cache, "_in_memory", LastFew(2))


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[range]:
    """The groups of rings that are computed, as they are."""
    groups: list[range] = []
    compute = harmonic_cache.compute_group

    def watched(stored, order, zone, rings, norms, n_zones):
        groups.append(rings)
        return compute(stored, order, zone, rings, norms, n_zones)

    monkeypatch.setattr(harmonic_cache, "compute_group", watched)
    return groups


def folder() -> Path:
    return Path(os.environ["TORCHBRDF_CACHE"]) / "harmonic"


def kept() -> list[Path]:
    """All but the locks."""
    return sorted(path for path in folder().rglob("*") if path.suffix != ".lock")


def the_file() -> Path:
    (path,) = kept()
    assert path.suffix == ".safetensors"
    return path


def values_of(content: bytes) -> bytes:
    """A file less its header, whose entries come in any order."""
    return content[8 + int.from_bytes(content[:8], "little") :]


def equal(one: HarmonicTransport, other: HarmonicTransport) -> bool:
    """Bit for bit."""
    numbers = [
        [(g.zone, g.first_ring, g.n_rings, g.places, g.first_row, [b.low for b in g.bands]) for g in t.groups]
        for t in (one, other)
    ]
    tensors = [list(harmonic_cache._tensors(t.groups)) for t in (one, other)]
    return numbers[0] == numbers[1] and all(torch.equal(a, b) for a, b in zip(*tensors, strict=True))


class TestReuse:
    def test_written_once_then_only_read(self, library: MaterialLibrary, built: list, forget: Callable) -> None:
        first = transport_of(library)
        computed = len(built)
        assert computed == len(first.groups) > 4
        before = the_file().stat()
        assert transport_of(library) is first
        forget()
        again = transport_of(library)
        assert again is not first
        assert equal(again, first)
        after = the_file().stat()
        assert (after.st_mtime_ns, after.st_ino, len(built)) == (before.st_mtime_ns, before.st_ino, computed)

    def test_parts_of_a_library_share_it(self, library: MaterialLibrary, built: list, forget: Callable) -> None:
        transport_of(library)
        computed = len(built)
        forget()
        transport_of(library.subset(["red"]))
        assert len(built) == computed
        the_file()

    def test_another_process_reads_it(self, library: MaterialLibrary, materials: Path) -> None:
        images = render_basis(library, PROBE, VIEW, backend="harmonic").packed
        before = the_file().stat()
        script = f"""
import importlib, sys, torch
for name, value in {COARSE!r}.items():
    module, constant = name.rsplit(".", 1)
    setattr(importlib.import_module(module), constant, value)
from torchbrdf.transport.harmonic import cache as harmonic_cache
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.light import LightProbe
from torchbrdf.rendering import render_basis
from torchbrdf.view import SphereView
def never(*_): raise AssertionError("computed again")
harmonic_cache.compute_group = never
library = MaterialLibrary.from_merl({str(materials)!r}, progress=False)
assert harmonic_cache.is_precomputed(library)
probe = LightProbe(torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(0)))
torch.save(render_basis(library, probe, SphereView(12)).packed, sys.argv[1])
"""
        found = folder().parent / "images.pt"
        subprocess.run([sys.executable, "-c", script, str(found)], check=True)
        torch.testing.assert_close(torch.load(found), images, rtol=1e-6, atol=1e-7)
        assert the_file().stat().st_mtime_ns == before.st_mtime_ns

    def test_a_library_that_changes_gets_another_file(
        self, library: MaterialLibrary, merl_directory: Path, tmp_path: Path, built: list
    ) -> None:
        transport_of(library)
        one, computed = the_file(), len(built)
        for name, content in (("red", "teal"), ("satin-0.5", "satin-0.5")):
            os.link(merl_directory / f"{content}.binary", tmp_path / f"{name}.binary")
        changed = MaterialLibrary.from_merl(tmp_path, progress=False)
        assert changed.names == library.names
        assert changed.source != library.source
        assert not is_precomputed(changed)
        transport_of(changed)
        assert len(built) > computed
        assert one in kept()
        assert len(kept()) == 2

    def test_another_grid_gets_another_file(
        self, library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        transport_of(library)
        monkeypatch.setattr("torchbrdf.transport.harmonic._compression.TOLERANCE", 0.1)
        assert not is_precomputed(library)

    def test_tables_in_memory_leave_no_file(self, tiny_tables: dict, built: list) -> None:
        library = MaterialLibrary.from_tables([tiny_tables["red"]])
        transport_of(library)
        computed = len(built)
        transport_of(library)
        assert len(built) == computed > 0
        assert not folder().exists()


def flipped_value(path: Path) -> None:
    with open(path, "r+b") as file:
        file.seek(-1001, os.SEEK_END)
        byte = file.read(1)[0]
        file.seek(-1001, os.SEEK_END)
        file.write(bytes([byte ^ 4]))


def truncated(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def emptied(path: Path) -> None:
    os.truncate(path, 0)


def not_safetensors(path: Path) -> None:
    path.write_bytes(b"this is no tensor file " * 1000)


def another_format(path: Path) -> None:
    with safe_open(path, "pt") as file:
        metadata, values = file.metadata(), file.get_tensor("values").clone()
    save_file({"values": values}, path, {**metadata, "format": "torchbrdf harmonic transport 0"})


def no_metadata(path: Path) -> None:
    save_file({"values": torch.zeros(3)}, path)


class TestDamage:
    @pytest.mark.parametrize(
        "damage", [flipped_value, truncated, emptied, not_safetensors, another_format, no_metadata]
    )
    def test_is_built_again(
        self,
        library: MaterialLibrary,
        forget: Callable,
        built: list,
        damage: Callable[[Path], None],
        capfd: pytest.CaptureFixture[str],
        recwarn: pytest.WarningsRecorder,
    ) -> None:
        first, computed = transport_of(library), len(built)
        path = the_file()
        sound = path.read_bytes()
        forget()
        other = path.with_suffix(".other")
        shutil.copy(path, other)  # what is mapped stays as it was
        damage(other)
        assert other.read_bytes() != sound
        os.replace(other, path)
        again = transport_of(library)
        assert len(built) == 2 * computed
        assert equal(again, first)
        assert values_of(the_file().read_bytes()) == values_of(sound)
        assert capfd.readouterr() == ("", "")
        assert not recwarn.list

    def test_bits_of_the_header(self, library: MaterialLibrary) -> None:
        """No flipped bit in the header may go unseen or raise: None, or what was written. (Every fourth byte.)"""
        expected = transport_of(library)
        sound = the_file().read_bytes()
        length = int.from_bytes(sound[:8], "little")
        bad = folder() / "bad.safetensors"
        wrong = []
        for at in range(8, 8 + length, 4):
            bad.write_bytes(sound[:at] + bytes([sound[at] ^ 1]) + sound[at + 1 :])
            try:
                found = harmonic_cache._read(bad)
                fine = found is None or equal(HarmonicTransport(found), expected)
                outcome = "read as another transport"
            except Exception as error:
                fine, outcome = False, repr(error)[:80]
            if not fine:
                wrong.append((at, outcome))
        assert not wrong, (len(wrong), length, wrong[:40])


class TestDisk:
    def test_no_room(self, library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch, built: list) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(total=1e9, used=9e8, free=1e8))
        with pytest.raises(OSError, match="make room") as caught:
            transport_of(library)
        assert str(caught.value) == (
            f"{folder()}: the harmonic transport needs 0.60 GB, 0.10 GB are free; make room or set TORCHBRDF_CACHE "
            "to another disk"
        )
        assert not built
        assert not kept()
        assert not is_precomputed(library)

    def test_no_room_is_needed_to_read(
        self, library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch, forget: Callable
    ) -> None:
        written = transport_of(library)
        forget()
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(total=1e9, used=1e9, free=0))
        assert equal(transport_of(library), written)

    @pytest.mark.parametrize("error", [SafetensorError("I/O error: No space left"), OSError(28, "No space left")])
    def test_a_write_that_fails_leaves_no_final_file(
        self, library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch, built: list, error: Exception
    ) -> None:
        sound = harmonic_cache.save_file
        total = sum(len(zone.groups) for zone in harmonic_cache.zones())
        writes = []

        def failing(tensors, path, metadata):
            writes.append(path)
            if len(writes) <= total:  # the parts, then the file of all
                return sound(tensors, path, metadata)
            Path(path).write_bytes(b"half of it")
            raise error

        monkeypatch.setattr(harmonic_cache, "save_file", failing)
        with pytest.raises(FullDiskError, match="it is full; make room there, or set TORCHBRDF_CACHE") as caught:
            transport_of(library)
        assert "\n" not in str(caught.value)
        assert not is_precomputed(library)
        assert not list(folder().glob("*.safetensors"))
        assert not list(folder().rglob(".*"))
        computed = len(built)
        assert computed == total
        monkeypatch.setattr(harmonic_cache, "save_file", sound)
        transport_of(library)
        assert len(built) == computed  # from the parts
        the_file()


class TestInterruption:
    def test_resumes_bit_for_bit(
        self, library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch, forget: Callable
    ) -> None:
        undisturbed = transport_of(library)
        whole = the_file().read_bytes()
        shutil.rmtree(folder())
        forget()
        compute, calls = harmonic_cache.compute_group, []

        def interrupted(*arguments):
            calls.append(arguments)
            if len(calls) == 4:
                raise KeyboardInterrupt
            return compute(*arguments)

        monkeypatch.setattr(harmonic_cache, "compute_group", interrupted)
        with pytest.raises(KeyboardInterrupt):
            transport_of(library)
        assert not is_precomputed(library)
        assert sorted(path.name for path in folder().glob("*.parts/*")) == [f"{i}.safetensors" for i in range(3)]
        again = transport_of(library)
        assert len(calls) == 1 + len(undisturbed.groups)
        assert equal(again, undisturbed)
        assert values_of(the_file().read_bytes()) == values_of(whole)

    def test_a_damaged_part_is_computed_again(
        self, library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch, built: list, forget: Callable
    ) -> None:
        undisturbed = transport_of(library)
        computed = len(built)
        shutil.rmtree(folder())
        forget()
        write = harmonic_cache._write

        def stopping(path: Path, groups: tuple) -> None:
            if len(groups) > 1:
                raise KeyboardInterrupt
            write(path, groups)

        monkeypatch.setattr(harmonic_cache, "_write", stopping)
        with pytest.raises(KeyboardInterrupt):
            transport_of(library)
        monkeypatch.setattr(harmonic_cache, "_write", write)
        (part,) = folder().glob("*.parts/2.safetensors")
        truncated(part)
        assert len(built) == 2 * computed
        assert equal(transport_of(library), undisturbed)
        assert len(built) == 2 * computed + 1


class TestAutomatic:
    def test_harmonic_after_precomputation(self, library: MaterialLibrary, forget: Callable) -> None:
        assert render_basis(library, PROBE, VIEW).description.startswith("sampled")
        assert not is_precomputed(library)
        transport_of(library)
        forget()
        assert is_precomputed(library)
        assert render_basis(library, PROBE, VIEW).description == "harmonic"
        assert render_basis(library.without("red"), PROBE, VIEW).description == "harmonic"

    def test_perspective_after_its_own(self, library: MaterialLibrary, forget: Callable) -> None:
        """In a file beside that of the orthographic view, which stays as it is."""
        view = SphereView(12, fov_deg=10)
        transport_of(library)
        (orthographic,) = kept()
        before = orthographic.stat().st_mtime_ns
        assert not is_precomputed(library, perspective=True)
        assert render_basis(library, PROBE, view).description.startswith("sampled")
        transport_of(library, perspective=True)
        forget()
        assert is_precomputed(library, perspective=True)
        assert render_basis(library, PROBE, view).description == "harmonic"
        assert len(kept()) == 2
        assert orthographic.stat().st_mtime_ns == before

    def test_kernels_read_back_as_computed(self, library: MaterialLibrary, forget: Callable) -> None:
        first = transport_of(library, perspective=True)
        forget()
        again = transport_of(library, perspective=True)
        assert first.added
        assert [group.order for group in again.added] == [group.order for group in first.added]
        assert equal(HarmonicTransport(again.added), HarmonicTransport(first.added))

    def test_sampled_where_samples_are_given_or_the_view_does_not_suit(self, library: MaterialLibrary) -> None:
        transport_of(library, perspective=True)
        assert render_basis(library, PROBE, VIEW, samples=64).description == "sampled, 64 samples a pixel, seed 0"
        assert render_basis(library, PROBE, SphereView(12, fov_deg=30)).description.startswith("sampled")
        assert render_basis(library, PROBE, VIEW, backend="sampled").description.startswith("sampled")

    def test_tables_in_memory_are_sampled(self, tiny_tables: dict) -> None:
        library = MaterialLibrary.from_tables([tiny_tables["red"]])
        transport_of(library)
        assert render_basis(library, PROBE, VIEW).description.startswith("sampled")


class TestLibraryThatGrew:
    @pytest.fixture
    def grown(self, library: MaterialLibrary, merl_directory: Path, monkeypatch: pytest.MonkeyPatch) -> MaterialLibrary:
        """By one material."""
        monkeypatch.setattr("torchbrdf.brdf.library.MIN_MATERIALS", 1)
        other = MaterialLibrary.from_files([merl_directory / "white.binary"], progress=False)
        return library + other

    def test_the_kernels_of_its_parts_serve_it(self, library: MaterialLibrary, grown: MaterialLibrary, built: list):
        transport_of(library)
        before = len(built)
        transport = transport_of(grown)
        groups = transport.groups
        assert {group.mixing.shape[0] for group in groups} == {grown.n}
        assert len(built) == 2 * before, "what is new is computed by itself, what was there is read"
        assert is_precomputed(grown)

    def test_its_images_are_those_of_the_parts(self, library: MaterialLibrary, grown: MaterialLibrary):
        one = render_basis(library, PROBE, VIEW, backend="harmonic")
        both = render_basis(grown, PROBE, VIEW, backend="harmonic")
        assert torch.allclose(both.packed[: library.n], one.packed, rtol=1e-4, atol=1e-6)

    def test_without_kernels_of_parts_it_is_computed_as_one(self, grown: MaterialLibrary):
        transport_of(grown)
        assert harmonic_cache._path(grown.stored).is_file()
