"""How pixels see rings: lookups of views that recur are read from disk, and are those that were built."""

from pathlib import Path

import pytest
import torch

from torchbrdf.transport.harmonic import transport as transport_module
from torchbrdf.transport.harmonic.cache import transport_of
from torchbrdf.transport.harmonic.transport import HarmonicTransport
from torchbrdf.view import NormalMapView, SphereView


def anew(library: object) -> HarmonicTransport:
    """The library's transport, with no lookup in memory."""
    return HarmonicTransport(transport_of(library).groups)


def test_a_lookup_that_is_read_is_the_one_that_was_built(precomputed_library, monkeypatch):
    view = SphereView(9)
    built = anew(precomputed_library).lookup(view)
    monkeypatch.setattr(transport_module.RingLookup, "build", lambda *_: pytest.fail("built again"))
    read = anew(precomputed_library).lookup(view)
    assert torch.equal(read.rank, built.rank)
    assert len(read.groups) == len(built.groups)
    for one, other in zip(read.groups, built.groups, strict=True):
        assert (one is None) == (other is None)
        if one is not None:
            assert one.pixels == other.pixels
            for name in ("places", "offsets", "weights"):
                assert torch.equal(getattr(one, name), getattr(other, name))


def test_a_view_that_sees_no_light_of_some_rings_is_read_as_built(precomputed_library):
    sphere = SphereView(8)
    lookup = anew(precomputed_library).lookup(NormalMapView(sphere.normals, sphere.mask & (sphere.normals[2:] > 0.9)))
    assert None in lookup.groups
    read = type(lookup).from_tensors(lookup.tensors)
    assert [group and group.start for group in read.groups] == [group and group.start for group in lookup.groups]


def test_views_that_do_not_recur_leave_no_file(precomputed_library, own_cache: Path):
    def files() -> set[Path]:
        return set((own_cache / "views").iterdir())

    transport = anew(precomputed_library)
    transport.lookup(SphereView(7))
    before, sphere = files(), SphereView(10)
    transport.lookup(NormalMapView(sphere.normals, sphere.mask))
    assert files() == before
    transport.lookup(SphereView(10))
    assert len(files()) == len(before) + 1
