import json
import subprocess
import sys

import pytest

from torchbrdf import commands

HEAVY = ("mitsuba", "drjit", "sklearn", "scipy", "matplotlib", "cv2", "OpenEXR", "kornia", "playwright", "skimage")
EVERY_NAME = "import torchbrdf; [getattr(torchbrdf, name) for name in torchbrdf.__all__]"


def modules_after(statement: str) -> set[str]:
    report = "print(json.dumps(sorted(m.split('.')[0] for m in sys.modules)))"
    command = f"import sys, json\n{statement}\n{report}"
    ran = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    return set(json.loads(ran.stdout.splitlines()[-1]))


def modules_after_command(*arguments: str) -> set[str]:
    """A command that ends by itself, as `--help` does."""
    run = f"from torchbrdf.cli import main\ntry: main({list(arguments)!r})"
    return modules_after(f"{run}\nexcept SystemExit as end: assert not end.code")


def test_import_loads_no_torch():
    loaded = modules_after("import torchbrdf")
    assert "torchbrdf" in loaded
    assert loaded.isdisjoint({"torch", "numpy", "argparse", *HEAVY})


def test_a_room_is_there_before_anything_of_it_was_used():
    assert "torchbrdf" in modules_after("import torchbrdf as tb; tb.brdf.N_CELLS; tb.learning.Blending; tb.view.View")
    absent = "try: torchbrdf.nowhere\nexcept AttributeError as error: assert 'nowhere' in str(error)"
    assert "torchbrdf" in modules_after(f"import torchbrdf\n{absent}\nelse: raise SystemExit(1)")


def test_every_public_name_is_light():
    """All of them together load nothing heavy that torch itself does not load."""
    assert modules_after(EVERY_NAME).intersection(HEAVY) - modules_after("import torch") == set()


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], *([name, "--help"] for name in commands.found())])
def test_help_loads_no_torch(arguments: list[str]):
    """It imports every command with its options, and nothing that only running one needs."""
    loaded = modules_after_command(*arguments)
    assert "torchbrdf" in loaded
    assert loaded.isdisjoint({"torch", "numpy", "tqdm", "safetensors", *HEAVY})


def test_the_checks_above_see_an_import():
    assert "scipy" in modules_after("import torchbrdf, scipy.ndimage")
    assert "torch" in modules_after("import torchbrdf; torchbrdf.LightProbe")


def test_idle_threads_sleep_whenever_torch_is_loaded_after_the_package():
    """GOMP_SPINCOUNT has to be set before libgomp reads it, though torch now comes later than the package."""
    script = "import os; os.environ.pop('GOMP_SPINCOUNT', None); import torchbrdf; print(os.environ['GOMP_SPINCOUNT'])"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True).stdout == "5000\n"
