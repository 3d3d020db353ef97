import json
import subprocess
import sys

HEAVY = ("mitsuba", "drjit", "sklearn", "scipy", "matplotlib", "cv2", "OpenEXR", "kornia", "playwright", "skimage")


def modules_after(statement: str) -> set[str]:
    report = "print(json.dumps(sorted(m.split('.')[0] for m in sys.modules)))"
    command = f"import sys, json; {statement}; {report}"
    ran = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    return set(json.loads(ran.stdout.splitlines()[-1]))


def test_import_is_light():
    """`import torchbrdf` loads nothing heavy that torch itself does not load."""
    loaded = modules_after("import torchbrdf")
    assert "torchbrdf" in loaded
    assert loaded.intersection(HEAVY) - modules_after("import torch") == set()


def test_the_check_above_sees_an_import():
    assert "scipy" in modules_after("import torchbrdf, scipy.ndimage")


def test_public_names_exist():
    import torchbrdf

    promised = [
        "BRDFEstimator",
        "BasisImages",
        "LightProbe",
        "MaterialClasses",
        "MaterialLibrary",
        "MerlTable",
        "NormalMapView",
        "Reconstruction",
        "SphereView",
        "render",
        "render_basis",
    ]
    assert [name for name in promised if not hasattr(torchbrdf, name)] == []
    assert [name for name in torchbrdf.__all__ if not hasattr(torchbrdf, name)] == []
