"""`torchbrdf convert`: a measured table from one file format to another."""

import argparse
from pathlib import Path

from torchbrdf.brdf import METRIC_NAMES, RGL_SUFFIX, TABLE_SUFFIX
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_table

EXAMPLES = (
    "torchbrdf convert result gold.bsdf",
    "torchbrdf convert satin_purple.bsdf satin_purple.binary",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is converted, to what."""
    add_table(parser)
    text = f"X{TABLE_SUFFIX}, a MERL table, or X{RGL_SUFFIX}, for Mitsuba's `measured` and pbrt-v4"
    parser.add_argument("written", type=Path, nargs="?", metavar="OUTPUT", help=text)
    parser.add_argument("-o", "--output", type=Path, metavar="OUTPUT", help="the same, as other commands have it")
    text = f"write spectra to the {RGL_SUFFIX}, as pbrt-v4 and Mitsuba's spectral variants need; default: RGB"
    parser.add_argument("--spectral", action="store_true", help=text)
    text = f"take the mean over all azimuths of an anisotropic {RGL_SUFFIX}"
    parser.add_argument("--isotropic", action="store_true", help=text)


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Convert a measured table: MERL's .binary to .bsdf and back; says what the file that was written holds of it."""
    from torchbrdf.brdf import cell_difference, measured_share, read_table
    from torchbrdf.commands._inputs import open_table
    from torchbrdf.files import writing

    if (options.written is None) == (options.output is None):
        raise ValueError("give one file to write, behind the table or with -o")
    output: Path = options.written or options.output
    if output.suffix.lower() not in (TABLE_SUFFIX, RGL_SUFFIX):
        raise ValueError(f"{output}: tables are written as {TABLE_SUFFIX} or {RGL_SUFFIX}; name the output so")
    if options.spectral and output.suffix.lower() != RGL_SUFFIX:
        raise ValueError(f"{output}: --spectral is for a {RGL_SUFFIX} file; a MERL table has red, green and blue alone")
    if options.isotropic and options.brdf.suffix.lower() != RGL_SUFFIX:
        raise ValueError(f"{options.brdf}: --isotropic is for an anisotropic {RGL_SUFFIX}; a MERL table is isotropic")
    with writing(output) as temporary:
        table = read_table(options.brdf, isotropic=True) if options.isotropic else open_table(options.brdf)
        table.save(temporary, options.spectral)
        written = read_table(temporary)
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
    findings.add_files(output)
    return 0
