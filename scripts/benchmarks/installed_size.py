#!/usr/bin/env python3
"""Claim: most of what an installation takes on Linux serves NVIDIA GPUs alone.

    python scripts/benchmarks/installed_size.py

Sums the files of torchbrdf and of all packages that it requires without extras, in the environment that runs this. What
serves NVIDIA GPUs alone are NVIDIA's packages, Triton, and the libraries of PyTorch that have cuda in their names.
"""

import re
from collections.abc import Iterator
from importlib import metadata

from packaging.requirements import Requirement

from torchbrdf.command_line import Parser
from torchbrdf.experiments import markdown_table

GPU_PACKAGES = re.compile(r"nvidia|cuda|triton")
GPU_LIBRARIES = re.compile(r"torch/lib/.*(cuda|nvshmem)")
LISTED = 8


def required(name: str, known: set[str]) -> Iterator[metadata.Distribution]:
    """A package and all that it requires here, each once."""
    key = re.sub(r"[-_.]+", "-", name).lower()
    if key in known:
        return
    known.add(key)
    try:
        package = metadata.distribution(name)
    except metadata.PackageNotFoundError:  # of another platform
        return
    yield package
    for text in package.requires or ():
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield from required(requirement.name, known)
            for extra in requirement.extras:
                yield from extras(requirement.name, extra, known)


def extras(name: str, extra: str, known: set[str]) -> Iterator[metadata.Distribution]:
    """What an extra of a package requires here."""
    for text in metadata.distribution(name).requires or ():
        requirement = Requirement(text)
        if requirement.marker is not None and requirement.marker.evaluate({"extra": extra}):
            yield from required(requirement.name, known)


def sizes() -> dict[str, tuple[int, int]]:
    """Package -> bytes of its files, and of those that serve NVIDIA GPUs alone."""
    found = {}
    for package in required("torchbrdf", set()):
        name, total, gpu = package.metadata["Name"], 0, 0
        for file in package.files or ():
            path = file.locate()
            size = path.stat().st_size if path.is_file() else 0  # type: ignore[attr-defined]
            total += size
            gpu += size if GPU_PACKAGES.match(name) or GPU_LIBRARIES.search(str(file)) else 0
        found[name] = total, gpu
    return found


def main() -> None:
    """Print the table."""
    Parser.of_script(__doc__).parse_args()
    found = sizes()
    largest = sorted(found.items(), key=lambda item: -item[1][0])
    rows = [[f"`{name}`", *(f"{size / 1e6:,.0f}" for size in pair)] for name, pair in largest[:LISTED]]
    others = [pair for _, pair in largest[LISTED:]]
    for name, some in ((f"{len(others)} others", others), ("**all**", list(found.values()))):
        rows.append([name, *(f"{sum(pair[k] for pair in some) / 1e6:,.0f}" for k in range(2))])
    print(markdown_table(["package", "MB", "for NVIDIA GPUs alone"], rows))


if __name__ == "__main__":
    main()
