"""`torchbrdf doctor` reports whatever is wrong and never fails with it."""

import importlib.metadata
import importlib.util
import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from torchbrdf.cli import main
from torchbrdf.commands import doctor
from torchbrdf.mitsuba_startup import trial as check
from torchbrdf.mitsuba_startup.loading import LLVM_VARIABLE, packaged_llvm
from torchbrdf.mitsuba_startup.trial import Trial, try_render

ABORTING = sorted(path for major in (15, 16) for path in Path("/usr/lib").glob(f"*/libLLVM-{major}*.so*"))
SOUND = Trial(
    {
        "variants": ["scalar_rgb", "llvm_ad_rgb"],
        "llvm_version": [23, 1, 4],
        "llvm_path": "/somewhere/libLLVM.so",
        "llvm_problem": None,
        "threads": 7,
        "variant": "llvm_ad_rgb",
        "mean": 0.5,
    }
)

needs_mitsuba = pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="mitsuba is not installed")


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch, tmp_path):
    """No LLVM named, a Dr.Jit cache of the test's own, a wide terminal."""
    monkeypatch.delenv(LLVM_VARIABLE, raising=False)
    monkeypatch.setenv(check.DRJIT_CACHE_VARIABLE, str(tmp_path / "kernels"))
    monkeypatch.setenv("COLUMNS", "10000")
    monkeypatch.setattr(doctor, "WIDEST", 10000)


@pytest.fixture
def report(capsys) -> Callable[[], tuple[int, list[str]]]:
    """Run the command; returns its exit status and its lines."""

    def run() -> tuple[int, list[str]]:
        status = main(["doctor"])
        captured = capsys.readouterr()
        assert captured.err == ""
        return status, captured.out.splitlines()

    return run


@pytest.fixture
def sound_mitsuba(monkeypatch) -> None:
    """Mitsuba's part is taken from a record, so that a test of another part is quick."""
    monkeypatch.setattr(doctor, "try_render", lambda variant: SOUND)


def line(lines: list[str], label: str) -> str:
    """The text of the only line with this label."""
    found = [text for text in lines if text.startswith(f"  {label} ")]
    assert len(found) == 1, lines
    return found[0].removeprefix(f"  {label}").strip()


def problems(lines: list[str]) -> list[str]:
    return lines[lines.index("Problems") + 1 :]


@needs_mitsuba
@pytest.mark.skipif(packaged_llvm() is None, reason="karellen-llvm-core is not installed")
def test_sound_installation_in_a_process_that_never_imports_mitsuba(tmp_path):
    command = "import sys; from torchbrdf.cli import main; print(main(['doctor'])); print('mitsuba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, timeout=100)
    lines = done.stdout.splitlines()
    assert lines[-3:] == ["no problems found", "0", "False"], done.stdout + done.stderr
    assert line(lines, "used") == "llvm_ad_rgb"
    assert line(lines, "its program") == f"{LLVM_VARIABLE}={packaged_llvm()} mitsuba SCENE.xml"
    assert "from the package karellen-llvm-core" in line(lines, "LLVM")
    assert not (tmp_path / "kernels").exists(), "the test render left kernels"


@needs_mitsuba
def test_a_text_file_as_llvm(report, monkeypatch, tmp_path):
    path = tmp_path / "libLLVM.so"
    path.write_text("this is no library\n" * 100)
    monkeypatch.setenv(LLVM_VARIABLE, str(path))
    status, lines = report()
    assert status == 1
    assert line(lines, "LLVM") == f"none that Dr.Jit takes (19 or newer needed), named by {LLVM_VARIABLE}={path}"
    assert line(lines, "llvm_ad_rgb").startswith(f'failed: jit_find_library(): Unable to load "{path}"')
    assert line(lines, "used") == "scalar_rgb (slow): a small render came out right"
    (problem,) = problems(lines)
    assert f"there is no usable LLVM at {LLVM_VARIABLE}={path}" in problem
    assert "unset DRJIT_LIBLLVM_PATH" in problem


@needs_mitsuba
@pytest.mark.skipif(not ABORTING, reason="no libLLVM 15 or 16 in /usr/lib/*")
def test_an_llvm_that_aborts(report, monkeypatch):
    if tuple(map(int, importlib.metadata.version("drjit").split(".")[:2])) < (1, 5):
        pytest.skip("Dr.Jit before 1.5 works with LLVM 15")
    monkeypatch.setenv(LLVM_VARIABLE, str(ABORTING[0]))
    status, lines = report()
    assert status == 1
    assert line(lines, "LLVM").endswith(f"named by {LLVM_VARIABLE}={ABORTING[0]}")
    assert line(lines, "llvm_ad_rgb").startswith("aborted (signal 6): LLVM ERROR")
    assert line(lines, "used") == "scalar_rgb (slow): a small render came out right"
    (problem,) = problems(lines)
    assert "llvm_ad_rgb aborted (signal 6): there is LLVM 1" in problem


def test_without_mitsuba(report, monkeypatch, tmp_path):
    (tmp_path / "mitsuba.py").write_text("raise ModuleNotFoundError(\"No module named 'mitsuba'\", name='mitsuba')")
    monkeypatch.syspath_prepend(tmp_path)
    status, lines = report()
    assert status == 1
    assert problems(lines) == [
        "  1. Mitsuba cannot be imported (No module named 'mitsuba'); run `pip install mitsuba karellen-llvm-core`"
    ]
    assert "Dr.Jit           unknown, Mitsuba does not load" in "\n".join(lines)


def test_a_mitsuba_that_crashes_on_import(monkeypatch, tmp_path):
    (tmp_path / "mitsuba.py").write_text("import os; os.abort()")
    monkeypatch.syspath_prepend(tmp_path)
    trial = try_render("llvm_ad_rgb")
    assert (trial.facts, trial.failure) == ({}, "aborted (signal 6)")


def test_a_mitsuba_that_hangs(monkeypatch):
    monkeypatch.setattr(check, "TIMEOUT", 0.05)
    assert str(try_render("llvm_ad_rgb")) == "did not end within 0.05 s and was stopped"


@pytest.mark.parametrize(
    ("trial", "said"),
    [
        (Trial({}, "crashed (signal 11)"), "Mitsuba does not load, crashed (signal 11); run `pip install --force"),
        (
            Trial(SOUND.facts, "aborted (signal 6)", "why"),
            "Mitsuba's llvm_ad_rgb aborted (signal 6): why; run `pip ins",
        ),
        (Trial(SOUND.facts | {"llvm_problem": "x; do y"}), "Mitsuba's llvm_ad_rgb is not used: x; do y"),
    ],
)
def test_each_failure_comes_with_what_to_do(report, monkeypatch, trial, said):
    monkeypatch.setattr(doctor, "try_render", lambda variant: trial if variant == "llvm_ad_rgb" else SOUND)
    status, lines = report()
    assert status == 1
    assert len(problems(lines)) == 1
    assert said in problems(lines)[0]


def test_wrong_values_are_a_failure(monkeypatch):
    def finished(*_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace(returncode=0, stdout=b'noise\ntorchbrdf-check {"mean": NaN}\n', stderr=b"")

    monkeypatch.setattr(subprocess, "run", finished)
    assert str(try_render("llvm_ad_rgb")) == "renders wrong values: nan where 0.5 is right"


@pytest.mark.usefixtures("sound_mitsuba")
def test_no_problems(report):
    status, lines = report()
    assert (status, lines[-1]) == (0, "no problems found")
    assert line(lines, "numpy") == __import__("numpy").__version__
    assert line(lines, "Dr.Jit           7") == "threads"


@pytest.mark.usefixtures("sound_mitsuba")
def test_a_package_that_does_not_import(report, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    status, lines = report()
    assert status == 1
    assert "OpenEXR cannot be imported (" in problems(lines)[0]
    assert problems(lines)[0].endswith("run `pip install --force-reinstall OpenEXR`")


@pytest.mark.usefixtures("sound_mitsuba")
def test_cache_folders_that_cannot_be_used(report, monkeypatch, tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file").touch()
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "loop"))
    monkeypatch.setenv(check.DRJIT_CACHE_VARIABLE, str(tmp_path / "file"))
    status, lines = report()
    assert status == 1
    first, second = problems(lines)
    assert f"torchbrdf's cache folder {tmp_path / 'loop'} cannot be used (Too many levels of symbolic links)" in first
    assert "set TORCHBRDF_CACHE to" in first
    assert f"Dr.Jit's cache folder {tmp_path / 'file'} cannot be used (Not a directory)" in second
    assert "set DRJIT_CACHE_DIR to" in second


@pytest.mark.usefixtures("sound_mitsuba")
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read and write everything")
@pytest.mark.parametrize("mode", [0o000, 0o500])
def test_a_cache_folder_without_permission(report, monkeypatch, tmp_path, mode):
    folder = tmp_path / "locked"
    folder.mkdir(mode)
    monkeypatch.setenv("TORCHBRDF_CACHE", str(folder))
    status, lines = report()
    folder.chmod(0o700)
    assert status == 1
    assert "cannot be used (Permission denied)" in problems(lines)[0]


@pytest.mark.usefixtures("sound_mitsuba")
def test_sizes_of_the_caches(report, monkeypatch, tmp_path):
    (tmp_path / "kernels" / "deep").mkdir(parents=True)
    (tmp_path / "kernels" / "deep" / "one").write_bytes(bytes(1500))
    (tmp_path / "kernels" / "two").write_bytes(bytes(500))
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "none" / "yet"))
    status, lines = report()
    assert status == 0
    assert f"Dr.Jit           {tmp_path / 'kernels'}: 2 kB, writable" in "\n".join(lines)
    assert f"torchbrdf        {tmp_path / 'none' / 'yet'}: not there yet, can be made" in "\n".join(lines)
    assert len(list((tmp_path / "kernels").iterdir())) == 2
    assert not (tmp_path / "none").exists()


@pytest.mark.usefixtures("sound_mitsuba")
def test_without_a_home(report, monkeypatch):
    for name in ("HOME", check.DRJIT_CACHE_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    status, lines = report()
    assert status == 1
    assert "Dr.Jit keeps no kernels, because HOME is not set; set DRJIT_CACHE_DIR" in problems(lines)[0]
    monkeypatch.setenv("TORCHBRDF_CACHE", "~no-such-user/cache")
    status, lines = report()
    assert "torchbrdf's cache folder is unknown (" in problems(lines)[0]


@pytest.mark.usefixtures("sound_mitsuba")
def test_full_disk(report, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=12_300_000))
    status, lines = report()
    assert status == 1
    assert problems(lines)[0].startswith("  1. only 12.3 MB free at ")


@pytest.mark.usefixtures("sound_mitsuba")
def test_cuda(report, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert line(report()[1], "torch  not") == "available, not needed"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "get_device_name", "card {}".format)
    lines = report()[1]
    assert (line(lines, "device 0"), line(lines, "device 1")) == ("card 0", "card 1")


@pytest.mark.usefixtures("sound_mitsuba")
def test_a_part_that_fails_is_a_line_and_the_others_follow(report, monkeypatch):
    def fail() -> bool:
        raise RuntimeError("driver\nis gone")

    monkeypatch.setattr(torch.cuda, "is_available", fail)
    status, lines = report()
    assert status == 1
    assert line(lines, "failed") == "RuntimeError: driver is gone"
    assert "Caches" in lines
    assert problems(lines)[0].startswith("  1. CUDA: RuntimeError: driver is gone; ")


@pytest.mark.usefixtures("sound_mitsuba")
def test_how_idle_threads_wait(report, monkeypatch):
    monkeypatch.setenv("GOMP_SPINCOUNT", "5000")
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    lines = report()[1]
    assert line(lines, "GOMP_SPINCOUNT") == "5000"
    assert line(lines, "OMP_WAIT_POLICY") == "not set"


@pytest.mark.usefixtures("sound_mitsuba")
def test_a_terminal_that_knows_only_ascii(monkeypatch, tmp_path):
    terminal = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "Zwischenspeicher-ä"))
    assert main(["doctor"]) == 0
    assert b"Zwischenspeicher-\\xe4: not there yet" in terminal.buffer.getvalue()


@pytest.mark.usefixtures("sound_mitsuba")
def test_lines_fit_the_terminal(report, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(doctor, "try_render", lambda _: Trial(SOUND.facts | {"variants": ["variant"] * 40}))
    lines = report()[1]
    listed = [text for text in lines if "variant, variant" in text]
    assert len(listed) > 3
    assert max(map(len, listed)) <= 80
    assert {len(text) - len(text.lstrip()) for text in listed[1:]} == {listed[0].index("variant,")}


def test_a_script_reads_the_same(sound_mitsuba, capsys, monkeypatch):
    """Labels and texts, and why the status is 1."""
    monkeypatch.setattr(doctor, "_caches", lambda section: section.problems.append("no cache; buy a disk"))
    assert main(["doctor", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["status"], told["error"], told["problems"]) == (1, "1 problem found", ["no cache; buy a disk"])
    assert list(told["sections"]) == ["Versions", "Mitsuba", "Threads", "CUDA", "Caches"]
    assert {"label": "Dr.Jit", "text": "7 threads"} in told["sections"]["Threads"]
