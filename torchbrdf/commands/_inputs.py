"""What several commands read: probes, libraries, views, tables, and messages that name the file."""

import argparse
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from math import log
from pathlib import Path

from torchbrdf.brdf import EMBEDDED, RESULT, MaterialLibrary, MerlTable, read_table, table_paths
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.commands._weights import primaries_of
from torchbrdf.files import did_you_mean, existing_file
from torchbrdf.images import (
    DEFAULT_SPACE,
    ColourSpace,
    Shooting,
    read_mask,
    read_shooting,
    readable_suffixes,
)
from torchbrdf.light import LightProbe
from torchbrdf.photograph import find_circle
from torchbrdf.view import MESH_SUFFIXES, Camera, MeshView, NormalMapView, SphereView, View

_READING = (
    "probe_layer", "probe_layout", "probe_rows", "probe_circle", "probe_mask", "probe_fov", "mirror_reflectance",
)  # fmt: skip
_DENIED = 0.1
"""Of the focal length's logarithm: focusing near makes it longer, and files round it."""
_CAMERA = ("toward", "up", "target", "width")


def check_reading(options: argparse.Namespace) -> None:
    """Raise ValueError where options say how to read the file of a probe that comes from none."""
    if options.probe == "default":
        for key in _READING:
            if getattr(options, key) not in (None, "latlong"):
                raise ValueError(f"--{key.replace('_', '-')} is for a probe from a file, and --probe is default")


def open_probe(options: argparse.Namespace) -> LightProbe:
    """The probe of `--probe`, read as the options beside it say."""
    check_reading(options)
    if options.probe == "default":
        return LightProbe.default(primaries=options.primaries)
    if not Path(options.probe).exists() and (meant := did_you_mean(options.probe, ["default"])):
        raise FileNotFoundError(f"{options.probe}: no such file{meant}; expected a light probe, or default")
    mask, circle = None, options.probe_circle
    if options.probe_mask is not None:
        mask = read_mask(options.probe_mask)
    if mask is not None and circle is None:
        with about(options.probe_mask):
            found = find_circle((mask.shape[1], mask.shape[2]), mask)
        circle = found.x, found.y, found.radius
    near = getattr(options, "fov", None) is not None or getattr(options, "focal_mm", None) is not None
    if options.probe_layout == "mirror_ball" and options.probe_fov is None and near:
        warnings.warn(
            f"{options.probe}: the mirror ball is read as seen from infinity; --fov is of the photograph alone, and "
            "--probe-fov DEG gives the horizontal field of view of the mirror ball's whole picture",
            UserWarning,
            stacklevel=2,
        )
    return LightProbe.open(
        options.probe,
        layout=options.probe_layout,
        repair=options.repair_probe,
        rows=options.probe_rows,
        circle=circle,
        mask=mask,
        reflectance=options.mirror_reflectance,
        fov_deg=options.probe_fov,
        primaries=options.primaries,
        layer=options.probe_layer,
        unknown_lamps=getattr(options, "align", False),
    )


def open_library(options: argparse.Namespace) -> MaterialLibrary:
    """The library of `--library`, else the embedded one; less what `--without` names."""
    if options.library is None:
        return MaterialLibrary.default().without(*options.without)
    library = MaterialLibrary.from_files(options.library, without=options.without)
    _warn_of_primaries(options)
    return library


def _warn_of_primaries(options: argparse.Namespace) -> None:
    """Of results in a library whose colours are neither those of the measured tables nor those asked for."""
    wanted = getattr(options, "primaries", DEFAULT_SPACE)
    for source in (Path(given) for given in options.library if given != EMBEDDED):
        for path in table_paths(source) if source.is_dir() else [source]:
            own = primaries_of(path)
            if own in (None, DEFAULT_SPACE, wanted) or path.absolute().parent.name in options.without:
                continue
            text = (
                f"{path}: its table is in {own}, and this library is taken in {wanted}, so its colours are off; fit "
                f"its photograph again without --primaries, or leave it out, --without {path.absolute().parent.name}"
            )
            warnings.warn(text, UserWarning, stacklevel=3)


def open_camera(options: argparse.Namespace, path: Path, size: tuple[int, int]) -> tuple[PinholeCamera | None, str]:
    """The camera of a whole photograph of so many rows and columns, and what told it; None where nothing does.

    By the options, else by the file's EXIF data or attributes; warns where those name a focal length that is of no use.
    """
    principal = None if options.principal is None else tuple(options.principal)
    distortion = options.distortion or ()
    if (options.focal_mm is None) != (options.sensor_mm is None):
        raise ValueError("--focal-mm and --sensor-mm belong together: give both, or --fov")
    shooting = read_shooting(path)
    if options.fov is not None:
        if options.focal_mm is not None:
            raise ValueError("--fov and --focal-mm say the same: give one of them")
        return _not_denied(PinholeCamera.of_fov(size, options.fov, principal, distortion), path, shooting), "as given"
    if options.focal_mm is not None:
        camera = PinholeCamera.of_focal(size, options.focal_mm, options.sensor_mm, principal, distortion)
        return _not_denied(camera, path, shooting), "as given"
    if shooting.focal_mm or shooting.focal_35mm_mm:
        try:
            focal = shooting.focal_pixels(size)
        except ValueError as error:
            message = f"{path} {error}: the camera's field of view is not known; give --fov"
            warnings.warn(message, UserWarning, stacklevel=2)
        else:
            if (doubt := shooting.doubt(size)) is not None:
                message = f"{path} {doubt}; if it is cropped, give --fov and --principal of what is left"
                warnings.warn(message, UserWarning, stacklevel=2)
            whole = "" if shooting.size else ", taken as whole"
            return PinholeCamera(size, focal, principal, tuple(distortion)), f"by what the file says{whole}"
    for key in ("principal", "distortion"):
        if getattr(options, key) is not None:
            raise ValueError(f"--{key} needs the camera's field of view: give --fov, or --focal-mm with --sensor-mm")
    return None, ""


def _not_denied(camera: PinholeCamera, path: Path, shooting: Shooting) -> PinholeCamera:
    """The camera that is given; warns where the file tells of quite another."""
    try:
        focal = shooting.focal_pixels(camera.size)
    except ValueError:
        return camera
    if abs(log(focal / camera.focal)) > _DENIED:
        other = PinholeCamera(camera.size, focal)
        message = (
            f"{path}: is by a {other} as its file says, and by one of {camera.fov_deg:.4g} as given, which is taken; "
            "--fov is across the width of the whole photograph"
        )
        warnings.warn(message, UserWarning, stacklevel=3)
    return camera


def open_view(options: argparse.Namespace, size: int, ball: Ball | None = None) -> View:
    """The view of `--view` and the camera's options.

    size  pixels along a side; a normal map brings its own
    ball  where the camera sees a sphere; None for one that fills its picture
    """
    path = Path(options.view)
    if path.suffix.lower() in MESH_SUFFIXES:
        given = {key: getattr(options, key) for key in _CAMERA if getattr(options, key) is not None}
        return MeshView(path, size, Camera(**given, fov_deg=options.fov), shadows=not options.no_shadows)
    if options.view != "sphere" and path.suffix.lower() not in readable_suffixes():
        raise ValueError(
            f"{path}: --view takes sphere, a mesh ({', '.join(MESH_SUFFIXES)}) or a normal map "
            f"({', '.join(readable_suffixes())}), got {path.suffix or 'no suffix'!r}"
        )
    for key in (*_CAMERA, "no_shadows"):
        if getattr(options, key) not in (None, False):
            raise ValueError(f"--{key.replace('_', '-')} is for a mesh, and --view is {options.view}")
    if options.view == "sphere":
        return SphereView(size, fov_deg=options.fov) if ball is None else SphereView.of_ball(size, ball)
    if options.fov is not None:
        raise ValueError(f"--fov is for a sphere or a mesh, and --view is {options.view}")
    return NormalMapView.open(path)


def open_table(path: Path, primaries: ColourSpace | None = None) -> MerlTable:
    """A MERL table or a measured material of the RGL database, or the table in a folder that `torchbrdf fit` wrote.

    primaries  the linear RGB of the light on it; None where there is none, and the table is taken in Rec. 709
    Raises ValueError where it is a result in other primaries: it holds a factor of the light for each of their
    channels, and the factors of other channels do not follow from these.
    """
    if path.is_dir():
        if not (path / RESULT).is_file():
            raise FileNotFoundError(
                f"{path}: no {RESULT} in this folder; name a MERL table or a folder of `torchbrdf fit`"
            )
        table = path / RESULT
    else:
        table = path if path.suffix else existing_file(path, "a MERL table or a folder of `torchbrdf fit`")
    wanted = primaries or DEFAULT_SPACE
    if (own := primaries_of(table)) not in (None, wanted):
        cure = f"fit the photograph again with --primaries {wanted}"
        raise ValueError(
            f"{path}: its table is in {own} (`fit --primaries`), and is taken in {wanted} here; "
            + (cure if primaries is None else f"give --primaries {own}, or {cure}")
        )
    return read_table(table)


def labels(paths: list[Path]) -> list[str]:
    """Short names of tables; where two agree, those are the paths as given; where those agree too, they are counted."""
    names = [path.resolve().name if path.is_dir() else path.stem for path in paths]
    names = [str(path) if names.count(name) > 1 else name for path, name in zip(paths, names, strict=True)]
    return [
        name if names.count(name) == 1 else f"{name} ({names[: i + 1].count(name)})" for i, name in enumerate(names)
    ]


@contextmanager
def about(path: Path) -> Iterator[None]:
    """Put the file's name before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        message = str(error)
        raise ValueError(message if str(path) in message else f"{path}: {message}") from None
