#!/usr/bin/env python3
"""Claim: a version of torchbrdf has the public names of another and gives its results to the last bit.

    git worktree add ../torchbrdf-0.6.0 8a03668
    python scripts/benchmarks/compare_versions.py ../torchbrdf-0.6.0 .

Each of the two arguments is the root of a checkout, which the running interpreter imports, or the python executable of
an environment in which that version is installed (`python -m venv old && old/bin/pip install ../torchbrdf-0.6.0`).
Revision 8a03668 is version 0.6.0. `git worktree remove ../torchbrdf-0.6.0` takes the checkout away again.

Both versions run the same code (versions/python.py and its neighbours), one after the other in a folder of the same
name, with the same seeds and number of threads, and write down facts: names and signatures, tensors, files, what
commands print. Then the new version opens the caches that the old one wrote, and must not touch them. Exit status: 0
where all is the same, 1 where something differs, 2 where the comparison could not run. About 2 minutes a version on two
cores, and 5 GB in the temporary folder.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from versions.record import Facts, Record, differences, table

THREADS = "1"
FIXED = {
    "COLUMNS": "110",
    "GOMP_SPINCOUNT": "5000",
    "LC_ALL": "C.UTF-8",
    "MKL_NUM_THREADS": THREADS,
    "NO_COLOR": "1",
    "OMP_NUM_THREADS": THREADS,
    "OPENBLAS_NUM_THREADS": THREADS,
    "PYTHONDONTWRITEBYTECODE": "1",
    "PYTHONHASHSEED": "0",
}
"""Of the environment of both processes."""

COULD_NOT_RUN = 2


@dataclass(frozen=True)
class Version:
    """One of the two that are compared: which Python runs it, and the checkout that it imports, if it is one."""

    role: str
    python: str
    tree: Path | None

    @classmethod
    def of(cls, role: str, argument: str) -> "Version":
        """From an argument of the command line."""
        path = Path(argument)
        if (path / "torchbrdf" / "__init__.py").is_file():
            return cls(role, sys.executable, path.resolve())
        if path.is_file() and os.access(path, os.X_OK):
            return cls(role, str(path.absolute()), None)  # not resolved: in an environment it is a link
        raise SystemExit(f"{argument}: neither the root of a checkout of torchbrdf nor a python executable")

    def facts(self, work: Path, mode: str) -> Facts:
        """What a process of this version writes down in `work`."""
        output = work / f"{self.role}-{mode}.json"
        environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")} | FIXED
        environment["TORCHBRDF_CACHE"] = str(work / "run" / "cache")
        if self.tree is not None:
            environment["PYTHONPATH"] = str(self.tree)
        began = time.monotonic()
        command = [self.python, str(Path(__file__).resolve()), "--child", str(output), mode]
        subprocess.run(command, cwd=work / "run", env=environment, check=True)
        facts = Facts.read(output)
        print(f"{self.role}: {time.monotonic() - began:.0f} s", file=sys.stderr)
        if self.tree is not None and self.tree not in Path(facts.location).parents:
            raise SystemExit(f"{self.role}: {facts.location} was imported instead of the checkout {self.tree}")
        return facts


def main() -> int:
    """Run both versions, print the table."""
    if "--child" in sys.argv[1:]:
        return child(Path(sys.argv[2]), sys.argv[3])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", help="root of a checkout, or python executable")
    parser.add_argument("new", help="the same of the version that is judged")
    parser.add_argument("--every", action="store_true", help="print every fact, not only those that differ")
    options = parser.parse_args()
    old, new = Version.of("old", options.old), Version.of("new", options.new)
    with tempfile.TemporaryDirectory(prefix="compare-versions-") as folder:
        try:
            return compare(old, new, Path(folder), options.every)
        except subprocess.CalledProcessError as error:
            print(f"a version did not come to its end: {error}", file=sys.stderr)
            return COULD_NOT_RUN


def child(output: Path, mode: str) -> int:
    """Write down the facts of the version that this process imports."""
    from versions import commands, estimates, python

    sections: dict[str, Callable[[Record], None]] = {
        "public names": python.public_names,
        "light probes": python.light_probes,
        "libraries": python.libraries,
        "tables": python.tables,
        "classes": python.classes,
        "images": python.images,
        "caches": python.caches,
        "estimates": estimates.estimates,
        "what is open": estimates.open_questions,
        "alignment": estimates.alignment,
        "analytic fits": estimates.analytic_fits,
        "help": commands.help_texts,
        "commands": commands.commands,
        "live": commands.live,
        "bad input": commands.bad_input,
    }
    record = Record(output.parent / "values")
    record.run(sections if mode == "all" else {"caches": python.caches})
    record.write(output)
    return 0


def compare(old: Version, new: Version, work: Path, every: bool) -> int:
    """Run the versions in a folder and print the table."""
    with running_in(work, "old"):
        before = old.facts(work, "all")
    with running_in(work, "new"):
        after = new.facts(work, "all")
    with running_in(work, "old"):
        written = states(work / "run" / "cache")
        reopened = new.facts(work, "caches")
        touched = changes(written, states(work / "run" / "cache"))
    rows = differences(before, after, work / "values")
    same_cache = before.only("caches")
    rows |= {
        f"caches of the old version, opened by the new/{name.partition('/')[2]}": difference
        for name, difference in differences(same_cache, reopened.only("caches"), work / "values").items()
    }
    rows[f"caches of the old version, opened by the new/{len(written)} files not written again"] = touched
    for version, facts in ((old, before), (new, after)):
        print(f"{version.role}: torchbrdf {facts.version} in {facts.location}")
    print("\n" + table(rows, every))
    failed = {name: text for facts in (before, after, reopened) for name, text in facts.failures().items()}
    for name, text in failed.items():
        print(f"did not run: {name}: {text}")
    return 1 if failed or any(rows.values()) else 0


@contextmanager
def running_in(work: Path, name: str) -> Iterator[None]:
    """Give the folder `name` the name `run` meanwhile: names in messages and caches come from it."""
    kept, run = work / name, work / "run"
    if kept.exists():
        kept.rename(run)
    else:
        run.mkdir()
    try:
        yield
    finally:
        run.rename(kept)


def states(folder: Path) -> dict[str, tuple[int, int, int]]:
    """What tells that a file was written again: by its name in the folder. Locks are opened for writing by design."""
    found = {str(path.relative_to(folder)): path.stat() for path in folder.rglob("*") if path.is_file()}
    return {
        name: (state.st_ino, state.st_mtime_ns, state.st_size)
        for name, state in sorted(found.items())
        if not name.endswith(".lock")
    }


def changes(before: Mapping[str, tuple[int, ...]], after: Mapping[str, tuple[int, ...]]) -> str:
    """Which files are not as they were; empty for none."""
    changed = [name for name in sorted({*before, *after}) if before.get(name) != after.get(name)]
    return f"written, or gone: {', '.join(changed)}" if changed else ""


if __name__ == "__main__":
    sys.exit(main())
