"""Loading Mitsuba never aborts the process: with a bad libLLVM, an old one, none, and without Mitsuba."""

import importlib.metadata
import importlib.util
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import pytest

from torchbrdf.mitsuba_startup import loading as startup
from torchbrdf.mitsuba_startup.loading import MitsubaUnavailableError, llvm_problem, load_mitsuba, packaged_llvm

SYSTEM_LIBRARIES = Path("/usr/lib")
ABORTING = sorted(path for major in (15, 16) for path in SYSTEM_LIBRARIES.glob(f"*/libLLVM-{major}*.so*"))
RENDER = """
from torchbrdf.mitsuba_startup.trial import ALBEDO, _render
assert abs(_render() - ALBEDO) < 0.1
"""
LOAD_TWICE = f"""
import json, warnings
from torchbrdf.mitsuba_startup import load_mitsuba
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    mi = load_mitsuba()
    load_mitsuba()
{RENDER}
result = {{"variant": mi.variant(), "level": mi.log_level().name, "warnings": [str(w.message) for w in caught]}}
"""

needs_mitsuba = pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="mitsuba is not installed")
needs_package = pytest.mark.skipif(packaged_llvm() is None, reason="karellen-llvm-core is not installed")


def in_process(script: str, folder: Path, llvm: object = None, path: tuple[Path, ...] = ()) -> dict:
    """`result` of a script in a process of its own that must end well; kernels are cached in `folder`."""
    env = {key: value for key, value in os.environ.items() if key != startup.LLVM_VARIABLE}
    env |= {"DRJIT_CACHE_DIR": str(folder / "kernels"), "OMP_NUM_THREADS": "1"}
    if llvm is not None:
        env[startup.LLVM_VARIABLE] = str(llvm)
    start = f"import sys; sys.path[:] = {[str(one) for one in path] + sys.path}\n"
    command = [sys.executable, "-c", start + script + "\nimport json; print(json.dumps(result))"]
    done = subprocess.run(command, env=env, cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@needs_mitsuba
@needs_package
def test_the_packaged_llvm_is_used_and_the_log_level_left(tmp_path):
    assert in_process(LOAD_TWICE, tmp_path) == {"variant": "llvm_ad_rgb", "level": "Warn", "warnings": []}


@needs_mitsuba
@pytest.mark.parametrize("kind", ["missing", "text"])
def test_a_bad_llvm_path_gives_the_slow_variant_and_one_sentence(tmp_path, kind):
    path = tmp_path / "libLLVM.so"
    if kind == "text":
        path.write_text("this is no library\n" * 100)
    result = in_process(LOAD_TWICE, tmp_path, path)
    assert result["variant"] == "scalar_rgb"
    assert len(result["warnings"]) == 1
    assert result["warnings"][0].startswith(
        "Mitsuba runs in its slow variant scalar_rgb: there is no usable LLVM at "
        f"DRJIT_LIBLLVM_PATH={path}, and Mitsuba needs version 19 or newer; unset DRJIT_LIBLLVM_PATH"
    )


@needs_mitsuba
@pytest.mark.skipif(not ABORTING, reason="no libLLVM 15 or 16 in /usr/lib/*")
def test_an_llvm_that_aborts_is_never_evaluated(tmp_path):
    """First no variant is set: fall back. Then the caller sets llvm_ad_rgb: refuse."""
    refused = """
mi.set_variant("llvm_ad_rgb")
try:
    load_mitsuba()
except ImportError as error:
    result |= {"error": str(error), "type": type(error).__name__}
"""
    result = in_process(LOAD_TWICE + refused, tmp_path, ABORTING[-1])
    assert result["variant"] == "scalar_rgb"
    assert len(result["warnings"]) == 1
    major = ABORTING[-1].name.removeprefix("libLLVM-")[:2]
    assert f"there is LLVM {major} at DRJIT_LIBLLVM_PATH={ABORTING[-1]}, and" in result["warnings"][0]
    assert result["type"] == "MitsubaUnavailableError"
    assert result["error"].startswith("Mitsuba's variant llvm_ad_rgb cannot be used: there is LLVM ")
    assert result["error"].endswith(', or call mitsuba.set_variant("scalar_rgb")')


@needs_mitsuba
@pytest.mark.parametrize(
    ("packaged", "named", "line"),
    [
        ("/env/lib/libLLVM.so", None, "DRJIT_LIBLLVM_PATH=/env/lib/libLLVM.so mitsuba 'my scene.xml'"),
        ("/env/lib/libLLVM.so", "/env/lib/libLLVM.so", "DRJIT_LIBLLVM_PATH=/env/lib/libLLVM.so mitsuba 'my scene.xml'"),
        ("/env/lib/libLLVM.so", "/usr/lib/libLLVM.so", "mitsuba 'my scene.xml'"),
        (None, None, "mitsuba -m scalar_rgb 'my scene.xml'"),
    ],
)
def test_the_line_for_mitsubas_own_program(monkeypatch, packaged, named, line):
    """With the LLVM of the package, which may have been named for this process alone; not with the system's."""
    monkeypatch.setattr(startup, "packaged_llvm", lambda: packaged and Path(packaged))
    monkeypatch.delenv(startup.LLVM_VARIABLE, raising=False)
    if named is not None:
        monkeypatch.setenv(startup.LLVM_VARIABLE, named)
    assert startup.mitsuba_program(Path("my scene.xml")) == line


@needs_package
def test_drjit_loaded_first_keeps_its_llvm(tmp_path):
    """The variable would come too late, and would be blamed for what Dr.Jit found itself."""
    script = """
import drjit, os
from torchbrdf.mitsuba_startup import loading as startup
startup.import_mitsuba()
result = os.environ.get(startup.LLVM_VARIABLE)
"""
    assert in_process(script, tmp_path) is None


def test_without_mitsuba(tmp_path):
    (tmp_path / "mitsuba.py").write_text("raise ModuleNotFoundError(\"No module named 'mitsuba'\", name='mitsuba')")
    script = """
from torchbrdf.mitsuba_startup import load_mitsuba
try:
    load_mitsuba()
except ImportError as error:
    result = [type(error).__name__, str(error)]
"""
    name, message = in_process(script, tmp_path, path=(tmp_path,))
    assert name == "MitsubaUnavailableError"
    assert message == (
        "Mitsuba cannot be imported (No module named 'mitsuba'); run `pip install mitsuba karellen-llvm-core`"
    )


def test_command_line_without_mitsuba_says_one_line(monkeypatch, capsys):
    from torchbrdf import cli

    def refuse(_: object, findings: object) -> int:
        """Refuse."""
        raise MitsubaUnavailableError("Mitsuba cannot be imported (why); do this")

    monkeypatch.setattr("torchbrdf.commands.classes.run", refuse)
    assert cli.main(["classes"]) == 2
    assert capsys.readouterr().err == "torchbrdf: error: Mitsuba cannot be imported (why); do this\n"


class FakeMitsuba:
    """As much of Mitsuba as load_mitsuba touches."""

    LogLevel = SimpleNamespace(Error="error")

    def __init__(self, variant: str | None = None) -> None:
        self.current, self.level = variant, "warn"

    def variant(self) -> str | None:
        return self.current

    def set_variant(self, name: str) -> None:
        if name == "cuda_ad_rgb":
            raise ImportError("the CUDA backend\n is inactive")
        self.current = name

    def log_level(self) -> str:
        return self.level

    def set_log_level(self, level: str) -> None:
        self.level = level


@pytest.fixture
def fake(monkeypatch):
    """Install a Mitsuba with this variant set, an LLVM of this version (-1: none), and perhaps the package."""

    def install(variant: str | None, llvm: int, package: Path | None = None, named: str | None = None) -> FakeMitsuba:
        mitsuba = FakeMitsuba(variant)
        version = SimpleNamespace(llvm_version=lambda: (llvm, 0, 0))
        monkeypatch.setitem(sys.modules, "mitsuba", mitsuba)
        monkeypatch.setitem(sys.modules, "drjit", SimpleNamespace(detail=version))
        monkeypatch.setattr(startup, "packaged_llvm", lambda: package)
        monkeypatch.delenv(startup.LLVM_VARIABLE, raising=False)
        if named is not None:
            monkeypatch.setenv(startup.LLVM_VARIABLE, named)
        startup._best_variant.cache_clear()
        return mitsuba

    yield install
    startup._best_variant.cache_clear()


def test_without_any_llvm(fake):
    mitsuba = fake(None, -1)
    with pytest.warns(UserWarning, match="slow variant scalar_rgb") as caught:
        assert load_mitsuba() is mitsuba
    assert len(caught) == 1
    assert mitsuba.current == "scalar_rgb"
    assert str(caught[0].message) == (
        "Mitsuba runs in its slow variant scalar_rgb: there is no usable LLVM on this system, "
        "and Mitsuba needs version 19 or newer; run `pip install karellen-llvm-core`"
    )
    assert caught[0].filename == __file__
    mitsuba.current = None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_mitsuba()


@pytest.mark.parametrize(("llvm", "usable"), [(-1, False), (14, False), (16, False), (18, False), (19, True)])
def test_which_versions_are_usable(fake, llvm, usable):
    fake(None, llvm)
    assert (llvm_problem() is None) == usable


PACKAGE = Path("/site/libLLVM.so")


@pytest.mark.parametrize(
    ("package", "named", "said"),
    [
        (None, None, "on this system, and Mitsuba needs version 19 or newer; run `pip install karellen-llvm-core`"),
        (None, "/x.so", "unset DRJIT_LIBLLVM_PATH and run `pip install karellen-llvm-core`"),
        (PACKAGE, "/x.so", "at DRJIT_LIBLLVM_PATH=/x.so, and Mitsuba needs version 19 or newer; unset DRJIT_LIBLLVM_"),
        (PACKAGE, str(PACKAGE), "in /site/libLLVM.so, and Mitsuba needs version 19 or newer; run `pip install --force"),
        (PACKAGE, None, "set DRJIT_LIBLLVM_PATH=/site/libLLVM.so before Python starts"),
    ],
)
def test_what_to_do_about_an_old_llvm(fake, package, named, said):
    fake(None, 16, package, named)
    assert said in llvm_problem()


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb", "cuda_ad_rgb"])
def test_the_variant_of_the_caller_is_kept(fake, variant):
    mitsuba = fake(variant, 23)
    load_mitsuba()
    assert mitsuba.current == variant


def test_a_variant_that_is_not_rgb_is_refused(fake):
    mitsuba = fake("scalar_spectral", 23)
    with pytest.raises(MitsubaUnavailableError, match="to be scalar_spectral, but torchbrdf works with linear RGB"):
        load_mitsuba()
    load_mitsuba("scalar_rgb")
    assert mitsuba.current == "scalar_rgb"


def test_a_variant_that_does_not_load_is_one_line(fake):
    fake(None, 23)
    with pytest.raises(MitsubaUnavailableError, match=r"cuda_ad_rgb cannot be used \(the CUDA backend is inactive\)"):
        load_mitsuba("cuda_ad_rgb")


def test_an_unusable_llvm_does_not_matter_to_scalar_and_cuda(fake):
    for variant in ("scalar_rgb", "cuda_ad_rgb"):
        assert fake(variant, 16).current == load_mitsuba().variant() == variant


def test_a_folder_named_mitsuba_is_not_mitsuba(fake, monkeypatch):
    fake(None, 23)
    monkeypatch.setitem(sys.modules, "mitsuba", SimpleNamespace(__path__=["/home/mitsuba"]))
    with pytest.raises(MitsubaUnavailableError, match=r"\['/home/mitsuba'\] is not Mitsuba 3"):
        load_mitsuba()


def test_no_package_no_path(monkeypatch):
    def missing(_: str) -> None:
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr(importlib.metadata, "files", missing)
    assert packaged_llvm() is None
    monkeypatch.setattr(importlib.metadata, "files", lambda _: None)
    assert packaged_llvm() is None
