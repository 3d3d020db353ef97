"""`READERS`: what torchbrdf reads, with files to mutate and the public functions that open them."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import numpy as np
import torch

import torchbrdf as tb
from fuzzing import mutations
from fuzzing.files import InputFile
from fuzzing.formats import basis_images, gltf, jpeg, merl, meshes, openexr, plain_pixels, png, radiance, tiff
from fuzzing.reading import CONSTANT
from torchbrdf.mitsuba_backend.baking import BakedSum
from torchbrdf.view import TriangleMesh

FileMutation = Callable[[InputFile, Random, Sequence[InputFile]], InputFile]


PROBE_CONSTANT = 384 << 20
"""As `fuzzing.reading.CONSTANT`, for light probes: pictures of whatever size are cut onto at least 512 rows."""


class WrongResultError(Exception):
    """A reader accepted a file and returned what no file of its kind can hold."""


@dataclass(frozen=True)
class Reader:
    """A format, and what opens it.

    name      on the command line
    seeds     sound files, and some that are not
    mutated   a seed, random numbers and all seeds -> a file that is probably damaged
    entries   functions of a path, by name, with how often each is taken; they raise WrongResultError where
              what was read cannot be
    constants bytes that entries may ask for beside TIMES_FILE times the file, where that is not CONSTANT
    """

    name: str
    seeds: Callable[[], list[InputFile]]
    mutated: FileMutation
    entries: Mapping[str, tuple[Callable[[Path], object], float]]
    constants: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def named(cls, source: str, name: str) -> "Reader":
        """From the READERS of a module."""
        found: Reader = importlib.import_module(source).READERS[name]
        return found

    def constant(self, entry: str) -> int:
        """Bytes that an entry may ask for beside TIMES_FILE times the file."""
        return self.constants.get(entry, CONSTANT)

    def input(self, seeds: Sequence[InputFile], seed: int, index: int) -> tuple[InputFile, str]:
        """A mutated file and the entry that shall open it: always the same for the same seeds and numbers."""
        rng = Random(f"{self.name} {seed} {index}")
        entry = rng.choices(list(self.entries), [share for _, share in self.entries.values()])[0]
        return self.mutated(rng.choice(seeds), rng, seeds), entry


def of_content(of_format: mutations.FormatMutation) -> FileMutation:
    """Mutations of a file's bytes."""

    def mutated(seed: InputFile, rng: Random, others: Sequence[InputFile]) -> InputFile:
        return seed.with_content(mutations.mutated(seed.content, rng, [other.content for other in others], of_format))

    return mutated


def _expect(sound: bool | torch.Tensor | np.ndarray, what: str) -> None:
    if not bool(torch.as_tensor(sound).all()):
        raise WrongResultError(f"expected {what}")


def _image(path: Path) -> None:
    image = tb.read_image(path, allow_ldr=True)
    _expect(image.ndim == 3 and image.shape[0] == 3 and image.dtype == torch.float32, "(3, H, W) float32")


def _mask(path: Path) -> None:
    mask = tb.read_mask(path)
    _expect(mask.ndim == 3 and mask.shape[0] == 1 and mask.dtype == torch.bool, "(1, H, W) bool")


def _probe(path: Path) -> None:
    _check_probe(tb.LightProbe.open(path, repair=True))


def _mirror_ball(path: Path) -> None:
    _check_probe(tb.LightProbe.open(path, layout="mirror_ball"))


def _check_probe(probe: tb.LightProbe) -> None:
    _expect(torch.isfinite(probe.radiance) & (probe.radiance >= 0), "finite radiance of at least 0")
    repr(probe)


def _normal_map(path: Path) -> None:
    normals = tb.read_image(path)
    try:
        view = tb.NormalMapView(normals)
    except ValueError as error:  # it knows no file; the commands put its name before the message
        raise ValueError(f"{path}: {error}") from None
    _expect(torch.isfinite(view.normals), "finite normals")


def _mesh(path: Path) -> None:
    mesh = TriangleMesh.open(path)
    corners = mesh.normals[mesh.faces]
    _expect((mesh.faces >= 0) & (mesh.faces < len(mesh.vertices)), "corners among the vertices")
    _expect(abs((corners**2).sum(-1) - 1) < 0.05, "unit normals")
    _expect(np.isfinite(mesh.vertices), "finite vertices")


def _table(path: Path) -> None:
    table = tb.MerlTable.open(path)
    _expect(torch.isfinite(table.values[table.valid]), "finite values")


def _basis_images(path: Path) -> None:
    basis = tb.BasisImages.load(path)
    _expect(torch.isfinite(basis.packed), "finite images")
    _expect(basis.unpack(basis.packed).shape == (basis.n, 3, *basis.size), "images of the mask's size")
    _expect(basis.image(basis.names[0]).dtype == torch.float32, "float32")
    repr(basis)


def _unfinished(path: Path) -> None:
    done = BakedSum.load(path, basis_images.UNFINISHED_IDENTITY, basis_images.UNFINISHED_SHAPE)
    _expect(torch.isfinite(done.mean), "finite images")
    _expect(torch.isfinite(done.relative_errors), "finite errors")


_IMAGE = {"read_image": (_image, 6.0)}
_PROBES = {"LightProbe.open": (_probe, 0.5), "LightProbe.open, mirror ball": (_mirror_ball, 0.25)}
_OF_PROBES = dict.fromkeys(_PROBES, PROBE_CONSTANT)
_LIGHT = _IMAGE | _PROBES
_MASK = _IMAGE | {"read_mask": (_mask, 3.0)}
_ANY_IMAGE = _LIGHT | _MASK | {"NormalMapView": (_normal_map, 1.0)}
_MESH = {"TriangleMesh.open": (_mesh, 1.0)}
_BASIS = {"BasisImages.load": (_basis_images, 1.0)}
_BAKE = {"BakedSum.load": (_unfinished, 1.0)}

READERS = {
    reader.name: reader
    for reader in (
        Reader("hdr", radiance.seeds, of_content(radiance.mutated), _LIGHT, _OF_PROBES),
        Reader("exr", openexr.seeds, of_content(openexr.mutated), _ANY_IMAGE, _OF_PROBES),
        Reader("png", png.seeds, of_content(png.mutated), _MASK),
        Reader("tiff", tiff.seeds, of_content(tiff.mutated), _ANY_IMAGE, _OF_PROBES),
        Reader("jpeg", jpeg.seeds, of_content(jpeg.mutated), _MASK),
        Reader("pfm", plain_pixels.pfm_seeds, of_content(plain_pixels.pfm_mutated), _ANY_IMAGE, _OF_PROBES),
        Reader("npy", plain_pixels.npy_seeds, of_content(plain_pixels.npy_mutated), _ANY_IMAGE, _OF_PROBES),
        Reader("obj", meshes.obj_seeds, of_content(meshes.obj_mutated), _MESH),
        Reader("ply", meshes.ply_seeds, of_content(meshes.ply_mutated), _MESH),
        Reader("gltf", gltf.seeds, of_content(gltf.mutated), _MESH),
        Reader("merl", merl.seeds, merl.mutated, {"MerlTable.open": (_table, 1.0)}),
        Reader("basis", basis_images.seeds, of_content(basis_images.mutated), _BASIS),
        Reader("bake", basis_images.unfinished_seeds, of_content(basis_images.mutated), _BAKE),
    )
}
