"""`torchbrdf convert`: a measured table, or a picture, from one file format to another."""

import argparse
from pathlib import Path

from torchbrdf.brdf import METRIC_NAMES, RGL_SUFFIX, TABLE_SUFFIX
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import TABLE_HELP, add_exposure, check_exposure

EXAMPLES = (
    "torchbrdf convert result gold.bsdf",
    "torchbrdf convert satin_purple.bsdf satin_purple.binary",
    "torchbrdf convert probe.exr probe.png",
)

_TABLES, _PICTURES = (TABLE_SUFFIX, RGL_SUFFIX), (".png", ".jpg", ".exr", ".hdr")
"""As which each is written."""

_OF_TABLES, _OF_PICTURES = ("spectral", "isotropic"), ("exposure", "layer")


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is converted, to what."""
    text = f"{TABLE_HELP}; or a linear picture, .exr, .hdr, .tif, .pfm or .npy"
    parser.add_argument("converted", type=Path, metavar="INPUT", help=text)
    text = (
        f"of a table X{TABLE_SUFFIX}, a MERL table, or X{RGL_SUFFIX}, for Mitsuba's `measured` and pbrt-v4; "
        "of a picture X.png or X.jpg (gamma 2.2, clipped), X.exr or X.hdr"
    )
    parser.add_argument("written", type=Path, nargs="?", metavar="OUTPUT", help=text)
    parser.add_argument("-o", "--output", type=Path, metavar="OUTPUT", help="the same, as other commands have it")
    text = f"write spectra to the {RGL_SUFFIX}, as pbrt-v4 and Mitsuba's spectral variants need; default: RGB"
    parser.add_argument("--spectral", action="store_true", help=text)
    text = f"take the mean over all azimuths of an anisotropic {RGL_SUFFIX}"
    parser.add_argument("--isotropic", action="store_true", help=text)
    add_exposure(parser)
    parser.add_argument("--layer", metavar="NAME", help="of a file that holds several pictures")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Convert a measured table, MERL's .binary to .bsdf and back, or a picture, such as .exr to .png to look at it.

    Of a table it says what the file that was written holds of it, of a picture by what radiance was multiplied.
    """
    from torchbrdf.images import kind_by_suffix

    if (options.written is None) == (options.output is None):
        raise ValueError("give one file to write, behind what is converted or with -o")
    output: Path = options.written or options.output
    kind = None if options.converted.is_dir() else kind_by_suffix(options.converted)
    known, suffix = _TABLES if kind is None else _PICTURES, output.suffix.lower().replace(".jpeg", ".jpg")
    if suffix not in known:
        what = "a table, and tables" if kind is None else f"a picture ({kind}), and pictures"
        shown = "; `torchbrdf render` makes a picture of it" if kind is None and suffix in _PICTURES else ""
        suffixes = f"{', '.join(known[:-1])} or {known[-1]}"
        raise ValueError(
            f"{output}: {options.converted} is {what} are written as {suffixes}; name the output so{shown}"
        )
    for name in _OF_PICTURES if kind is None else _OF_TABLES:
        if getattr(options, name) not in (None, False):
            other = f"of a picture, and {options.converted} is a table" if kind is None else "of a table"
            raise ValueError(f"--{name} is {other}: leave it out")
    (_convert_table if kind is None else _convert_picture)(options, output, findings)
    findings.add_files(output)
    return 0


def _convert_table(options: argparse.Namespace, output: Path, findings: Findings) -> None:
    from torchbrdf.brdf import cell_difference, measured_share, read_table
    from torchbrdf.commands._inputs import open_table
    from torchbrdf.commands._said import kept
    from torchbrdf.files import writing

    if options.spectral and output.suffix.lower() != RGL_SUFFIX:
        raise ValueError(f"{output}: --spectral is for a {RGL_SUFFIX} file; a MERL table has red, green and blue alone")
    if options.isotropic and options.converted.suffix.lower() != RGL_SUFFIX:
        raise ValueError(
            f"{options.converted}: --isotropic is for an anisotropic {RGL_SUFFIX}; a MERL table is isotropic"
        )
    with writing(output) as temporary:
        table = read_table(options.converted, isotropic=True) if options.isotropic else open_table(options.converted)
        table.save(temporary, options.spectral)
        try:
            with kept([]):  # what reading it warns of is interpolation: a table that was written has no such colours
                written = read_table(temporary)
        except ValueError as error:
            raise ValueError(str(error).replace(str(temporary), str(output))) from None
    findings.line(f"read {table}")
    found = {name: float(cell_difference(written, table, name)) for name in METRIC_NAMES}
    differences = ", ".join(f"{name} {value:.2%}" for name, value in found.items())
    common = measured_share(written.valid & table.valid)
    differs = f"it differs by {differences}, over the {common:.1%} of the cells above the horizon that both measured"
    findings.line(f"wrote {output}: read again, {differs}")
    if output.suffix.lower() == RGL_SUFFIX:
        readers = "Mitsuba's spectral variants and pbrt-v4" if options.spectral else "Mitsuba's RGB variants"
        findings.line(f"for {readers}; {'without' if options.spectral else 'with'} --spectral for the others")
    findings.add(differences=found, common=common)


def _convert_picture(options: argparse.Namespace, output: Path, findings: Findings) -> None:
    import torch

    from torchbrdf.commands._carried import Carried
    from torchbrdf.images import DISPLAY_SUFFIXES, exposure_for, read_picture, write_image

    check_exposure(output, options.exposure)
    to_look_at = output.suffix.lower() in DISPLAY_SUFFIXES
    picture = read_picture(options.converted, True if to_look_at else None, layer=options.layer)
    exposure, said = 1.0, []
    finite = torch.isfinite(picture.image).all(0, keepdim=True)
    infinite = ~finite & (picture.image == torch.inf).any(0, keepdim=True)
    if to_look_at:
        exposure = exposure_for(picture.image, finite) if options.exposure is None else options.exposure
        said = [f"radiance times {exposure:.3g}"]
        shown = {"too bright for a number, white": infinite, "not a number, black": ~finite & ~infinite}
        said += [f"{int(where.sum())} of its pixels are {what}" for what, where in shown.items() if where.any()]
    write_image(output, picture.image * exposure, **Carried.of(options.converted, picture).kept(output))
    if picture.about:
        findings.line(f"read {options.converted} ({'; '.join(picture.about)})")
    findings.line("; ".join([f"wrote {output}", *said]))
    findings.add(exposure=exposure)
