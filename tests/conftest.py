"""What several test modules share: the data beside the repository, small libraries, a cache of their own.

What takes long to import is imported where it is used: the process that waits for the others needs none of it.
"""

from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

os.environ.setdefault("GOMP_SPINCOUNT", "5000")  # as torchbrdf sets it where it is imported before torch
if "PYTEST_XDIST_WORKER" in os.environ:  # the processes of a run share the cores
    os.environ["OMP_NUM_THREADS"] = "1"

import pytest

from paths import ROOT

if TYPE_CHECKING:
    from torch import Tensor

    from torchbrdf import MaterialLibrary, MerlTable


def pytest_collectstart(collector: pytest.Collector) -> None:
    """Before any module of tests is imported, which leaves no garbage."""
    if isinstance(collector, pytest.Session):
        import hypothesis

        hypothesis.settings.register_profile("torchbrdf", deadline=None, max_examples=60)
        hypothesis.settings.load_profile("torchbrdf")
        gc.disable()


def pytest_collection_finish() -> None:
    """What was imported and collected stays: the garbage collector need not look at it again and again."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """Headless Chromium, with WebGL computed by the processor; skips where there is none. It takes 2 s to start."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        pytest.skip("no Chromium on this machine to open the page in")
    flags = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
    flags += ["--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=flags)
        try:
            yield opened
        finally:
            opened.close()


@pytest.fixture
def browser(chromium: Any) -> Iterator[Any]:
    """A browser without pages, which keeps nothing of the test before: what a test opens in it is closed after it."""
    yield chromium
    for context in chromium.contexts:
        context.close()


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """TORCHBRDF_CACHE in a temporary folder: no test reads or writes the user's cache."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHBRDF_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> Iterator[None]:
    """Ctrl-C ends what the tests start, even where a shell runs them in the background, which makes them ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def seeded() -> None:
    """The same random numbers in every run; what lives longer than a test takes a generator."""
    import torch

    torch.default_generator.manual_seed(0)  # `torch.manual_seed` asks for every device, for a millisecond


@pytest.fixture
def must_end() -> Iterator[None]:
    """Turn an endless loop into a failure: a minute is a hundred times what these tests need."""

    def stop(*_: object) -> None:
        raise TimeoutError("still running after 60 s: an endless loop")

    if not hasattr(signal, "SIGALRM"):
        yield
        return
    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def mitsuba() -> Iterator[ModuleType]:
    """Mitsuba in its fast variant, which is the one set after the test, too."""
    from torchbrdf.mitsuba_startup.loading import FAST_VARIANT, MitsubaUnavailableError, load_mitsuba

    try:
        module = load_mitsuba(FAST_VARIANT)
    except MitsubaUnavailableError as error:
        pytest.skip(f"Mitsuba cannot be loaded: {error}")
    yield module
    module.set_variant(FAST_VARIANT)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The data beside the repository."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("../shared/data is not there")
    return folder


@pytest.fixture(scope="session")
def decode(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Write tables of MERL materials from their neural encodings: close to the measurements, not the measurements."""

    def decode(*materials: str) -> Path:
        folder = tmp_path_factory.mktemp("decoded")
        command = [sys.executable, shared_data.parent / "tools" / "decode_merl_neural.py", folder, "--materials"]
        ran = subprocess.run([*command, *materials], capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr
        return folder

    return decode


@pytest.fixture(scope="session")
def decoded_pink_felt(decode: Callable[..., Path]) -> MerlTable:
    """pink-felt from its neural encoding."""
    from torchbrdf import MerlTable

    return MerlTable.open(decode("pink-felt") / "pink-felt.binary")


@pytest.fixture(scope="session")
def tiny_tables() -> dict[str, MerlTable]:
    """Ten analytic materials by name."""
    from materials import TINY_MATERIALS
    from torchbrdf import MerlTable

    return {name: MerlTable.from_function(f_r, name) for name, f_r in TINY_MATERIALS.items()}


@pytest.fixture(scope="session")
def tiny_library(tiny_tables: dict[str, MerlTable]) -> MaterialLibrary:
    """The ten analytic materials as a library in memory."""
    from torchbrdf import MaterialLibrary

    return MaterialLibrary.from_tables(list(tiny_tables.values()))


@pytest.fixture(scope="session")
def default_library(own_cache: Path, tmp_path_factory: pytest.TempPathFactory) -> MaterialLibrary:
    """The embedded library, which no test changes: its expansion takes many seconds and happens once in a whole run."""
    from torchbrdf import MaterialLibrary

    own = tmp_path_factory.getbasetemp()
    made = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "embedded"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHBRDF_CACHE", str(made))
        MaterialLibrary.default(progress=False)
    (own_cache / "libraries").mkdir(exist_ok=True)
    with suppress(FileExistsError):
        (own_cache / "libraries" / "default").symlink_to(made / "libraries" / "default")
    return MaterialLibrary.default(progress=False)


@pytest.fixture(scope="session")
def precomputed_directory(tiny_tables: dict[str, MerlTable], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight `.binary` files, from matte to nearly a mirror, for tests of the harmonic transport only."""
    folder = tmp_path_factory.mktemp("precomputed")
    for name in ("white", "red", "teal", "satin-0.35", "plastic-0.1", "gold-0.3", "steel-0.15", "copper-0.08"):
        tiny_tables[name].save(folder / f"{name}.binary")
    return folder


@pytest.fixture(scope="module")
def half_grid() -> Iterator[None]:
    """HALF_GRID in the place of the grid at work, which tests/transport/harmonic/test_basis.py is about."""
    from coarse_grids import HALF_GRID, computed_on

    with computed_on(HALF_GRID):
        yield


@pytest.fixture(scope="module")
def precomputed_library(own_cache: Path, precomputed_directory: Path, half_grid: None) -> MaterialLibrary:
    """Their library. It lives in the cache, so that its transport is computed once in a whole run, in 5 s."""
    from torchbrdf import MaterialLibrary
    from torchbrdf.transport.harmonic.cache import transport_of

    library = MaterialLibrary.from_merl(precomputed_directory, progress=False)
    transport_of(library)
    return library


@pytest.fixture(scope="session")
def strangers() -> dict[str, MerlTable]:
    """The tables of STRANGERS."""
    from materials import STRANGERS
    from torchbrdf import MerlTable

    return {name: MerlTable.from_function(f_r, name) for name, f_r in STRANGERS.items()}


@pytest.fixture(scope="session")
def photographs(strangers: dict[str, MerlTable]) -> dict[str, Tensor]:
    """(3, 48, 48) spheres of STRANGERS under `LightProbe.default(64)`, by the sampled transport: 0.5 % noise."""
    from torchbrdf import LightProbe, SphereView
    from torchbrdf.rendering import render_tables

    images = render_tables(list(strangers.values()), LightProbe.default(64), SphereView(48), samples=1024, seed=3)
    return dict(zip(strangers, images, strict=True))


@pytest.fixture(scope="session")
def merl_directory(tiny_tables: dict[str, MerlTable], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight sound `.binary` files; tests that change them work on links or copies."""
    folder = tmp_path_factory.mktemp("merl")
    for name, table in list(tiny_tables.items())[:8]:
        table.save(folder / f"{name}.binary")
    return folder


@pytest.fixture
def linked_merl(merl_directory: Path, tmp_path: Path) -> Path:
    """A directory of its own with hard links to the same files: replace a file, do not write into it."""
    folder = tmp_path / "materials"
    folder.mkdir()
    for path in merl_directory.iterdir():
        os.link(path, folder / path.name)
    return folder
