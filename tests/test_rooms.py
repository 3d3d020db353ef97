"""The rooms of the package: what each hands on, what stays inside, and where new things go."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest

import torchbrdf
from paths import ROOT
from torchbrdf import commands
from torchbrdf.analytic import MODELS, models
from torchbrdf.light import Layout
from torchbrdf.light.layouts import layout_of

PACKAGE = ROOT / "torchbrdf"
FACES = sorted(PACKAGE.rglob("__init__.pyi"))
ROOMS = sorted(path.parent for path in PACKAGE.rglob("__init__.py") if path.parent != PACKAGE)

pytestmark = pytest.mark.skipif(not PACKAGE.is_dir(), reason="the sources are not here")


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


@cache
def statements(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """All of a file that import, lazily or not."""
    return [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Import | ast.ImportFrom)]


def imports(path: Path) -> Iterator[tuple[str, str]]:
    """Modules of this package and names that a file takes from them."""
    for node in statements(path):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "torchbrdf":
            yield from ((node.module, name.name) for name in node.names)


def handed_on(face: Path) -> dict[str, str]:
    """The names of a face and the modules that they come from."""
    nodes = [node for node in ast.parse(face.read_text()).body if isinstance(node, ast.ImportFrom)]
    return {name.asname or name.name: node.module or "" for node in nodes for name in node.names}


def test_the_package_itself_holds_few_modules():
    assert len(list(PACKAGE.glob("*.py"))) <= 10


@pytest.mark.parametrize("room", ROOMS, ids=dotted)
def test_a_room_says_what_it_is_for(room: Path):
    text = ast.get_docstring(ast.parse((room / "__init__.py").read_text())) or ""
    assert re.search(r"\bIn: .*\bOut: ", text, re.DOTALL), f"{room} does not say what comes in and what goes out"


@pytest.mark.parametrize("face", FACES, ids=dotted)
def test_what_a_face_hands_on_is_there_and_hides_no_module(face: Path):
    package = import_module(dotted(face.parent))
    names = handed_on(face)
    assert [name for name in names if not hasattr(package, name)] == []
    assert sorted(package.__all__) == sorted(names)
    assert names.keys() & {path.stem for path in face.parent.iterdir()} == set()


def test_rooms_are_entered_by_their_faces():
    """From outside nothing but a room's face is imported, scripts may also take modules that are not private."""
    climbing = []
    files = [*PACKAGE.rglob("*.py"), *(ROOT / "scripts").rglob("*.py")]
    for path in files:
        inside = PACKAGE in path.parents
        home = dotted(path.parent) if inside else ""
        for module, name in imports(path):
            room, _, last = module.rpartition(".")
            if room in ("", "torchbrdf") and not last.startswith("_"):
                continue  # a face, or a module of the package itself
            if (f"{home}.").startswith(f"{room}."):
                continue  # at home
            if (PACKAGE / Path(*module.split(".")[1:])).is_dir() or (not inside and not last.startswith("_")):
                continue  # the face of a room within a room
            climbing.append(f"{path.relative_to(ROOT)}: from {module} import {name}")
    assert climbing == []


def test_nothing_below_the_command_line_imports_the_package_itself():
    """Its names come from rooms, its version from `_version`: what imports it would climb to the root."""
    climbing = []
    for path in PACKAGE.rglob("*.py"):
        plain = {name.name for node in statements(path) if isinstance(node, ast.Import) for name in node.names}
        taken = {name for module, name in imports(path) if module == "torchbrdf"}
        modules = {name for name in taken if (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file()}
        if "torchbrdf" in plain or taken != modules:
            climbing.append(path.name)
    assert climbing == ["cli.py"]


def test_a_face_hands_on_only_what_somebody_outside_uses():
    """Other rooms, the scripts, the documentation, or everybody by way of the package."""
    pages = "\n".join(path.read_text() for path in [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"])
    words = set(re.findall(r"\w+", pages))
    used = {(module, name) for path in (ROOT / "scripts").rglob("*.py") for module, name in imports(path)}
    for path in PACKAGE.rglob("*.py"):
        home = dotted(path.parent)
        used |= {(module, name) for module, name in imports(path) if not (f"{home}.").startswith(f"{module}.")}
    used |= {(f"torchbrdf.{module}", name) for name, module in handed_on(PACKAGE / "__init__.pyi").items()}
    idle = []
    for face in FACES:
        room = dotted(face.parent)
        for name in handed_on(face):
            documented = name in words or f"automodule:: {room}\n" in pages
            if room != "torchbrdf" and (room, name) not in used and not documented:
                idle.append(f"{room}.{name}")
    assert idle == []


def test_tests_stand_in_the_same_rooms():
    tests = ROOT / "tests"
    folders = {path.parent for path in tests.rglob("test_*.py")} - {tests, tests / "scripts"}
    assert [folder for folder in folders if not (PACKAGE / folder.relative_to(tests)).is_dir()] == []


def test_every_file_of_models_is_a_model_and_named_after_it():
    files = {path.stem for path in (PACKAGE / "analytic" / "models").glob("*.py")} - {"__init__"}
    assert {name.replace("-", "_") for name in MODELS} == files
    assert tuple(MODELS) == models.NAMES
    assert [model.name for model in MODELS.values()] == list(MODELS)


def test_every_file_of_layouts_is_a_layout():
    files = {path.stem for path in (PACKAGE / "light" / "layouts").glob("[a-z]*.py")}
    assert {"latlong", *files} == set(get_args(Layout))
    assert all(callable(layout_of(name).placed) for name in files)


def test_every_file_of_commands_is_a_command():
    files = {path.stem for path in (PACKAGE / "commands").glob("[a-z]*.py")}
    found = commands.found()
    assert set(found) == files
    assert all(command.run.__doc__ and callable(command.add_options) for command in found.values())


def test_everything_public_is_public_as_before():
    """The names of 0.6.0, and those that came with 0.9.0."""
    names = (
        "Ball PinholeCamera "
        "Alignment AnalyticFit BRDFEstimator BasisImages Camera HarmonicBasis LightProbe MaterialClasses "
        "MaterialLibrary MerlTable MeshView NormalMapView Reconstruction SphereView View align fit_analytic "
        "fit_analytic_batch fit_analytic_to_image read_image read_mask read_table render render_basis "
        "render_directional write_image"
    )
    assert sorted(torchbrdf.__all__) == sorted(names.split())
