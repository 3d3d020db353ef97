"""The facts that `import torchbrdf` gives: names, light probes, libraries, tables, classes, views, images, caches."""

import inspect
import os
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

import torchbrdf as tb
from torchbrdf import mitsuba_backend
from versions.record import Record

LIBRARY = Path("merl")
PHOTOGRAPHED, OTHER = "nylon", "brass"

_MODULE = re.compile(r"\btorchbrdf\.(?:\w+\.)*(?=[A-Z])")
"""Hidden in signatures: the module that holds a class is what moves."""


def numbers(seed: int, *shape: int) -> Tensor:
    """Uniform in [0, 1)."""
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def directions(seed: int, count: int, front: bool = False) -> Tensor:
    """(count, 3) unit vectors, uniform on the sphere; with `front` most of them lie above the horizon."""
    vectors = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))
    return normalize(vectors + torch.tensor([0.0, 0.0, 2.0 * front]), dim=-1)


def turn(degrees: float) -> Tensor:
    """(3, 3): a turn about an axis that is none of the coordinates'."""
    x, y, z = normalize(torch.tensor([0.3, 0.8, -0.5], dtype=torch.float64), dim=0).tolist()
    generator = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return torch.linalg.matrix_exp(np.radians(degrees) * generator)


@contextmanager
def said(record: Record, name: str) -> Iterator[None]:
    """Write down the warnings of a block."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        yield
    record.add(f"{name}/warnings", "\n".join(f"{one.category.__name__}: {one.message}" for one in caught))


@dataclass(frozen=True)
class Scene:
    """What several sections share: the embedded library without one material, a library of files, a photograph."""

    whole: tb.MaterialLibrary
    few: tb.MaterialLibrary
    probe: tb.LightProbe
    view: tb.SphereView

    @cached_property
    def library(self) -> tb.MaterialLibrary:
        """Without the photographed material."""
        return self.whole.without(PHOTOGRAPHED)

    @cached_property
    def basis(self) -> tb.BasisImages:
        """Of `library`."""
        return tb.render_basis(self.library, self.probe, self.view, "sampled", samples=512)

    @cached_property
    def classes(self) -> tb.MaterialClasses:
        """Of `library`."""
        return tb.MaterialClasses.fit(self.library)

    @cached_property
    def photograph(self) -> Tensor:
        """(3, H, W) with 1 % noise."""
        clean = tb.render(self.whole.table(PHOTOGRAPHED), self.probe, self.view, samples=1024, seed=1)
        return clean * (0.98 + 0.04 * numbers(1, *clean.shape))


@cache
def scene() -> Scene:
    """Made once: the files of a library first, with a time of their own, because the cache's stamp holds it."""
    whole = tb.MaterialLibrary.default(progress=False)
    LIBRARY.mkdir(exist_ok=True)
    for name in whole.names[::8]:
        path = LIBRARY / f"{name}.binary"
        if not path.exists():
            whole.table(name).save(path)
            os.utime(path, (1e9, 1e9))
    few = tb.MaterialLibrary.from_merl(LIBRARY, progress=False)
    return Scene(whole, few, tb.LightProbe.default(64), tb.SphereView(24))


def public_names(record: Record) -> None:
    """__all__ of both public namespaces, and what stands behind each of their names."""
    for prefix, module in (("", tb), ("mitsuba_backend.", mitsuba_backend)):
        record.add(f"public names/{prefix}__all__", "\n".join(sorted(module.__all__)))
        for name in sorted(module.__all__):
            value = getattr(module, name)
            if callable(value):
                record.add(f"signatures/{prefix}{name}", f"{name}{_signature(value)}")
            if inspect.isclass(value):
                record.add(f"bases/{prefix}{name}", " ".join(base.__name__ for base in value.__mro__))
                record.add("signatures", {f"{prefix}{name}.{key}": text for key, text in _members(value)})


def _members(owner: type) -> Iterator[tuple[str, str]]:
    """Public methods and properties that the package defines, with their kind and signature."""
    for key in sorted(dir(owner)):
        member = inspect.getattr_static(owner, key)
        of_property = getattr(member, "fget", None) or getattr(member, "func", None)
        function = of_property or getattr(member, "__func__", member)
        if key.startswith("_") or not str(getattr(function, "__module__", "")).startswith("torchbrdf"):
            continue
        yield key, f"{type(member).__name__} {_signature(function)}"


def _signature(value: Callable[..., Any]) -> str:
    """With annotations evaluated, so that quotes around one make no difference; as written where that fails."""
    if inspect.isclass(value) and issubclass(value, Exception):
        return "(*args)"  # of a built-in type, which tells none
    try:
        signature = inspect.signature(value, eval_str=True)
    except NameError:
        signature = inspect.signature(value)
    return _MODULE.sub("", str(signature))


def light_probes(record: Record) -> None:
    """Probes from files, made and changed; sampling and looking up."""
    for suffix in (".exr", ".hdr"):
        tb.write_image(f"latlong{suffix}", 10 ** (4 * numbers(1, 3, 24, 48) - 2))
        tb.write_image(f"square{suffix}", 10 ** (4 * numbers(2, 3, 40, 40) - 2))
        layouts: dict[str, dict[str, Any]] = {
            "latlong": {}, "latlong, 10 rows": {"height": 10}, "angular": {"layout": "angular"},
            "mirror_ball": {"layout": "mirror_ball"}, "mirror_ball, 30 rows": {"layout": "mirror_ball", "height": 30},
        }  # fmt: skip
        for name, options in layouts.items():
            file = ("latlong" if name.startswith("latlong") else "square") + suffix
            record.add(f"light probes/open/{name} {suffix}", _probe(tb.LightProbe.open(file, **options)))
        record.add(f"light probes/files/latlong{suffix}", Path(f"latlong{suffix}"))
    holes = 10 ** (4 * numbers(3, 3, 16, 32) - 2)
    holes[:, 3:5, 30:] = torch.nan
    holes[1, 9, 9] = -1
    with said(record, "light probes/repaired"):
        record.add("light probes/repaired", _probe(tb.LightProbe(holes, repair=True)))
    probe = tb.LightProbe.default(48)
    quarter = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    for name, made in {
        "default": tb.LightProbe.default(), "turned": probe.rotated(turn(20)), "quarter turn": probe.rotated(quarter),
        "blurred": probe.blurred(3.0), "smaller": probe.resized(20), "larger": probe.resized(100),
        "scaled": probe.scaled(1.7), "sky": tb.LightProbe.sky(30.0, height=64),
        "sky without sun": tb.LightProbe.sky(8.0, 7.0, sun=False, height=64),
    }.items():  # fmt: skip
        record.add(f"light probes/{name}", _probe(made))


def _probe(probe: tb.LightProbe) -> dict[str, Any]:
    towards, density = probe.sample(numbers(4, 500, 2))
    seen = directions(5, 500)
    return {
        "radiance": probe.radiance, "fingerprint": probe.fingerprint, "repr": repr(probe), "power": probe.total_power,
        "mean": probe.mean_radiance, "solid angles": probe.solid_angles, "sampled": towards,
        "their density": density, "pdf": probe.pdf(seen), "radiance_at": probe.radiance_at(seen),
    }  # fmt: skip


def libraries(record: Record) -> None:
    """The embedded library, its subsets, libraries of files and of tables."""
    whole, few = scene().whole, scene().few
    in_memory = tb.MaterialLibrary.from_tables([few.table(name) for name in few.names[:3]])
    for name, library in {
        "default": whole, "without": whole.without("brass", "nylon"), "subset": whole.subset(["teflon", "brass"]),
        "from_merl": few, "from_tables": in_memory,
    }.items():  # fmt: skip
        cells = (numbers(6, 2000) * 90 * 90 * 180).long()
        weights = torch.where(numbers(7, library.n, 3) < 0.1, numbers(8, library.n, 3) - 0.3, 0)
        weights[0] = 1
        combined = library.combine(weights)
        facts = {
            "names": ", ".join(library.names), "source": library.source, "gram": library.gram, "repr": repr(library),
            "columns": library.column_index, "rows": library.rows(cells), "combined": combined.values,
            "combined, valid": combined.valid,
        }  # fmt: skip
        record.add(f"libraries/{name}", facts)
    record.add("libraries/map_rows", few.map_rows(lambda rows: rows[:, :3].sqrt()))


def tables(record: Record) -> None:
    """MerlTable: values, lookups, files."""
    made = tb.MerlTable.from_function(lambda w_i, w_o: 0.1 + (w_i + w_o).square(), "made")
    opened = tb.MerlTable.open(min(LIBRARY.iterdir()))
    w_i, w_o = directions(1, 4000, front=True), directions(2, 4000, front=True)
    for name, table in {"embedded": scene().whole.table(OTHER), "of a file": opened, "made": made}.items():
        table.save(f"{name}.binary")
        facts = {
            "values": table.values, "valid": table.valid, "repr": repr(table), "measured": table.measured_share,
            "nearest": table.lookup(w_i, w_o), "linear": table.lookup(w_i, w_o, interpolation="linear"),
            "linear, double": table.lookup(w_i.double(), w_o.double(), interpolation="linear"),
            "saved": Path(f"{name}.binary"), "opened": tb.MerlTable.open(f"{name}.binary").values,
        }  # fmt: skip
        record.add(f"tables/{name}", facts)


def classes(record: Record) -> None:
    """Material classes of several libraries, numbers of classes and of dimensions."""
    for name, library, options in (
        ("default library", scene().whole, {}), ("without one", scene().library, {}), ("files", scene().few, {}),
        ("3 classes", scene().whole, {"n_classes": 3, "n_dims": 2}), ("seed 1", scene().whole, {"seed": 1}),
    ):  # fmt: skip
        with said(record, f"classes/{name}"):
            found = tb.MaterialClasses.fit(library, **options)
        record.add(f"classes/{name}", {"table": found.table(), "repr": repr(found), **found.state_dict()})
    record.add("classes/single", tb.MaterialClasses.single(scene().whole).state_dict())


@cache
def views() -> dict[str, tb.View]:
    """A sphere, a normal map, and a torus, which shades itself, each by two cameras; written by trimesh."""
    import trimesh

    if not Path("torus.ply").exists():
        trimesh.creation.torus(1.0, 0.45, major_sections=32, minor_sections=16).export("torus.ply")
    y, x = torch.meshgrid(torch.linspace(3, -3, 20), torch.linspace(-3, 3, 24), indexing="ij")
    normals = normalize(torch.stack([x.sin(), (y + 0.5 * x).cos(), 1.3 + 0 * x]), dim=0)
    mask = (x.square() + y.square() < 6)[None]
    return {
        "sphere": tb.SphereView(16),
        "sphere, near": tb.SphereView(16, fov_deg=40.0),
        "normal map": tb.NormalMapView(normals),
        "normal map, masked, near": tb.NormalMapView(normals, mask, normals + 2 * numbers(3, 3, 1, 1)),
        "mesh": tb.MeshView("torus.ply", 20),
        "mesh, near": tb.MeshView("torus.ply", 20, tb.Camera.at((1.0, 2.0, 4.0), (0.0, 0.1, 0.0), 40.0)),
        "mesh, no shadows": tb.MeshView("torus.ply", 20, tb.Camera((0.2, 0.4, 1.0), width=2.5), shadows=False),
    }


def images(record: Record) -> None:
    """Views, basis images by every backend, and pictures of one table."""
    library, probe, table = scene().few, scene().probe, scene().whole.table(OTHER)
    light = torch.tensor([0.4, 0.5, 0.8])
    with said(record, "views/all"):
        shown = views()
    for name, view in shown.items():
        record.add(f"views/{name}", {
            "mask": view.mask, "normals": view.normals, "directions": view.view_dirs, "fingerprint": view.fingerprint,
            "coverage": view.normal_coverage, "repr": repr(view),
        })  # fmt: skip
        backends: dict[str, dict[str, Any]] = {
            "sampled": {"samples": 256}, "not adaptive": {"samples": 64, "adaptive": False, "seed": 3},
            "mitsuba": {"backend": "mitsuba", "samples": 32, "seed": 2},
        }  # fmt: skip
        if name in ("sphere", "normal map"):
            backends["harmonic"] = {"backend": "harmonic"}
        for backend, options in backends.items():
            rendered = tb.render_basis(library, probe, view, **options)
            record.add(f"basis images: {backend}/{name}", _basis(rendered))
        record.add(f"render/{name}", {
            "probe": tb.render(table, probe, view, samples=512, seed=2),
            "directional": tb.render_directional(table, view, 60.0, irradiance=3.0),
            "towards": tb.render_directional(table, view, direction=light, subpixels=2),
        })  # fmt: skip
        if not isinstance(view, tb.NormalMapView):
            halves = mitsuba_backend.MitsubaScene(view, probe, table).render_halves(32, seed=1)
            record.add(f"render/{name}, by Mitsuba", {"image": halves.image, "noise": halves.noise})
    rendered = tb.render_basis(library, probe, shown["sphere"])
    rendered.save("basis.safetensors")
    record.add("basis images: auto, in a file", {
        **_basis(rendered), "saved": Path("basis.safetensors"),
        "loaded": _basis(tb.BasisImages.load("basis.safetensors", library, probe, shown["sphere"])),
        "without": rendered.without(library.names[2]).packed,
    })  # fmt: skip
    harmonic = tb.HarmonicBasis(library, probe, shown["sphere"])
    weights = numbers(9, library.n, 3)
    record.add("basis images: turned", {
        "basis": _basis(harmonic.basis_at(turn(7))), "image": harmonic.image_at(weights, turn(7)),
        "change": harmonic.change_at(weights, turn(7)),
    })  # fmt: skip


def _basis(basis: tb.BasisImages) -> dict[str, Any]:
    keys = ("packed", "names", "library", "probe", "view", "description", "normal_coverage", "distrust", "n")
    errors = {} if basis.relative_errors is None else {"errors": basis.relative_errors}
    shown = {"image": basis.image(basis.names[0]), "repr": repr(basis)}
    return {key: getattr(basis, key) for key in keys} | shown | errors


def caches(record: Record) -> None:
    """Names and content of what lies in the cache, after a library of each kind and its transport were opened."""
    basis = tb.render_basis(scene().few, scene().probe, scene().view)
    record.add("caches/default library", {"source": scene().whole.source, "gram": scene().whole.gram})
    record.add("caches/library of files", {"source": scene().few.source, "gram": scene().few.gram})
    record.add("caches/harmonic transport", {"description": basis.description, "basis": basis.packed})
    folder = Path(os.environ["TORCHBRDF_CACHE"])
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix != ".lock")
    record.add("caches/file names", "\n".join(str(path.relative_to(folder)) for path in files))
    record.add("caches/files", {str(path.relative_to(folder)).replace("/", " "): path for path in files})
