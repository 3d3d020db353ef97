"""`torchbrdf precompute`: what it says of the transport that is ready."""

import json
import re
from pathlib import Path

import pytest

from torchbrdf.brdf import MaterialLibrary
from torchbrdf.cli import main
from torchbrdf.transport.harmonic import files_of
from torchbrdf.transport.harmonic.cache import _in_memory


@pytest.fixture
def precompute(precomputed_library: MaterialLibrary, precomputed_directory: Path, capsys: pytest.CaptureFixture[str]):
    """Runs the command; returns what it prints on both streams."""

    def run(*more: str) -> tuple[str, str]:
        assert main(["precompute", "--library", str(precomputed_directory), "--orthographic", *more]) == 0
        said = capsys.readouterr()
        return said.out, said.err

    return run


def test_what_was_there(precompute, precomputed_library: MaterialLibrary):
    (file,) = files_of(precomputed_library)
    size = file.stat().st_size
    assert precompute() == (
        "ready for photographs of balls, without --fov, by the library of 8 materials: "
        f"{size / 1e6:.0f} MB in {file.parent}, which were there\n",
        "",
    )
    told = json.loads(precompute("--json")[0])
    assert (told["materials"], told["perspective"], told["bytes"], told["files"]) == (8, False, size, [])


def test_what_has_to_be_made(precompute, precomputed_library: MaterialLibrary):
    """A line says what takes long, beside the bar or without it, and that it is once."""
    (file,) = files_of(precomputed_library)
    kept = file.rename(file.with_suffix(".kept"))
    try:
        _in_memory.clear()
        out, err = precompute()
    finally:
        kept.rename(file)
    assert re.search(r": \d+ MB in .*, made in \d+ s\n$", out)
    assert err == (
        "harmonic transport of 8 materials: computed once for this library, which takes half a minute or so where "
        f"there are a hundred, and kept in {file.parent}\n"
    )
