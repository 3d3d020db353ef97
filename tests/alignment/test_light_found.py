"""Light that was softer than the probe, and the light of other rooms: what finding it needs, on a finer grid.

The photographs show the probe as it is, and `align` is given a turned or a blurred one, as in test_alignment.py.
"""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.alignment._search import RotationSearch, Trial
from torchbrdf.alignment.alignment import Alignment, align
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.images.difference import relative_rms
from torchbrdf.light.probe import LightProbe
from torchbrdf.transport.harmonic.basis import HarmonicBasis
from torchbrdf.view.sphere import SphereView
from turns import degrees_between, turn_about

ROOM = LightProbe.default(64)
VIEW = SphereView(48)
STRAIGHT = torch.eye(3, dtype=torch.float64)


@pytest.fixture(scope="module")
def aligned(precomputed_library: MaterialLibrary) -> Callable[..., Alignment]:
    """`align` with defaults for everything but the photograph and the probe."""

    def run(image: Tensor, probe: LightProbe, **options: object) -> Alignment:
        return align(image, probe, VIEW, precomputed_library, **options)

    return run


@pytest.mark.filterwarnings("ignore:.*material class:UserWarning")
def test_light_that_was_not_seen(
    aligned: Callable[..., Alignment],
    photographs: dict[str, Tensor],
    strangers: dict[str, MerlTable],
    precomputed_library: MaterialLibrary,
) -> None:
    """Under a novel light the reconstruction is as right as with the true probe, within 10 %.

    And 0.2 %: the probe was resampled when it was turned away.
    """
    given_probe = ROOM.rotated(turn_about((1, -2, 1.5), 4).T)
    found = aligned(photographs["paint"], given_probe)
    novel = ROOM.rotated(turn_about((0, 1, 0), 90))
    target = VIEW.pack(tb.render(strangers["paint"], novel, VIEW, samples=1024))
    novel_basis = HarmonicBasis(precomputed_library, novel, VIEW).basis_at()
    classes = tb.MaterialClasses.fit(precomputed_library, 2, 2)

    def error(basis: tb.BasisImages) -> float:
        weights = tb.BRDFEstimator(basis, classes)(photographs["paint"]).weights
        image = torch.einsum("nc,ncp->cp", weights.float(), novel_basis.packed)
        return relative_rms(image, target)

    straight, given = (HarmonicBasis(precomputed_library, probe, VIEW).basis_at() for probe in (ROOM, given_probe))
    assert error(found.basis) < 1.1 * error(straight) + 0.002
    assert error(given) > 3 * error(straight)  # what a turned light does to the picture is partly shared by pixels


class TestBlur:
    """Of the probe, which the photograph shows sharper or softer than it was captured."""

    @pytest.mark.parametrize(("sigma", "columns"), [(3.0, 0), (2.0, 1)])
    def test_is_found(
        self,
        aligned: Callable[..., Alignment],
        strangers: dict[str, MerlTable],
        precomputed_library: MaterialLibrary,
        sigma: float,
        columns: int,
    ) -> None:
        """Under a right probe, and with a turn by a whole texel, which blurs nothing."""
        image = tb.render(strangers["brass"], ROOM.blurred(sigma), VIEW, samples=512)
        rotation = turn_about((0, 1, 0), -columns * 360 / 128)
        given = ROOM.rotated(rotation.T)
        found = aligned(image, given, blur=True)
        assert found.blur == pytest.approx(sigma, rel=0.25)
        assert degrees_between(found.rotation, rotation) < 0.15
        expected = given.blurred(found.blur).rotated(found.rotation)
        assert torch.equal(found.probe.radiance, expected.radiance)
        basis = HarmonicBasis(precomputed_library, given.blurred(found.blur), VIEW).basis_at(found.rotation)
        assert torch.equal(found.basis.packed, basis.packed)
        truth = ROOM.blurred(sigma).radiance
        assert relative_rms(found.probe.radiance, truth) < 0.5 * relative_rms(given.radiance, truth)
        assert f", blurred by {found.blur:.2f} degrees (" in str(found)
        if not columns:
            assert torch.equal(found.rotation, STRAIGHT)

    def test_a_sharp_probe_stays_sharp(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor]
    ) -> None:
        found = aligned(photographs["paint"], ROOM, blur=True)
        assert found.blur == 0
        assert torch.equal(found.probe.radiance, ROOM.radiance)
        assert "blurred" not in str(found)

    def test_every_rotation_looked_at_counts(
        self, aligned: Callable[..., Alignment], photographs: dict[str, Tensor], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Those for a blur that is not found, too."""
        looked_at = []
        trial = RotationSearch.trial

        def counted(task: RotationSearch, rotation: Tensor) -> Trial:
            looked_at.append(rotation)
            return trial(task, rotation)

        monkeypatch.setattr(RotationSearch, "trial", counted)
        found = aligned(photographs["brass"], ROOM, blur=True)
        assert found.blur == 0
        assert found.evaluations == len(looked_at) > 1
