"""`torchbrdf compare`: tables side by side, on a page to look at."""

import argparse
import warnings
from dataclasses import asdict
from pathlib import Path

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import TABLE_HELP, add_light, add_output, add_samples, add_size
from torchbrdf.files import writing
from torchbrdf.progress import told_if_slow
from torchbrdf.report import COMPARISON_SAMPLES, COMPARISON_SIZE

EXAMPLES = (
    "torchbrdf compare measured.binary result -o comparison.html",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is compared, and how well."""
    parser.add_argument("brdfs", type=Path, nargs="+", metavar="BRDF", help=TABLE_HELP)
    add_size(parser, COMPARISON_SIZE, "pixels along a sphere; default: %(default)s")
    add_samples(parser, COMPARISON_SAMPLES, "samples a pixel, on average")
    add_light(parser, default="default")
    add_output(parser, "X.html")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Compare BRDFs with the first: spheres, slices, curves, differences, and a light to turn; one HTML page."""
    from torchbrdf.commands._inputs import labels, open_probe, open_table
    from torchbrdf.report import Comparison, write_comparison

    paths = options.brdfs
    if len(paths) < 2:
        raise ValueError(f"compare needs two BRDFs or more, got {paths[0]} alone; name the reference first")
    if options.output.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{options.output}: the comparison is a page; name it X.html")
    with writing(options.output) as temporary:
        tables = [open_table(path, options.primaries) for path in paths]
        names = labels(paths)
        probe = open_probe(options)
        settings = {"size": options.size, "samples": options.samples, "primaries": options.primaries}
        with told_if_slow(f"comparing {len(names)} BRDFs"):
            comparison = Comparison.of(tables, probe, names, **settings)
            write_comparison(temporary, comparison)
    for name, difference in zip(names[1:], comparison.differences, strict=True):
        cells = ", ".join(f"{metric} {value:.2%}" for metric, value in difference.cells.items())
        findings.line(
            f"{name} from {names[0]}: {cells}; picture {difference.picture:.2%}, "
            f"delta E mean {difference.delta_e_mean:.2f}, 95 % below {difference.delta_e_95:.2f}"
        )
    for text in comparison.warnings:
        warnings.warn(text, UserWarning, stacklevel=2)
    findings.line(f"wrote {options.output}")
    told = [{"name": name} | asdict(one) for name, one in zip(names[1:], comparison.differences, strict=True)]
    findings.add(reference=names[0], differences=told)
    findings.add_files(options.output)
    return 0
