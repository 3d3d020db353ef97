"""`torchbrdf precompute`: what it says of the transport that is ready."""

import json
from pathlib import Path

import pytest

from torchbrdf.brdf import MaterialLibrary
from torchbrdf.cli import main
from torchbrdf.transport.harmonic import files_of


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
