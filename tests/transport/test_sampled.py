"""Light transport: closed forms, an independent sum over the probe, symmetries, randomness, bad input."""

import math
from math import pi
from unittest.mock import MagicMock

import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from probes import lamps, probe_of, relative, texel_directions
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.images.difference import relative_rms
from torchbrdf.light.latlong import directions_at
from torchbrdf.light.probe import LightProbe
from torchbrdf.light.strata import SIDE, LightStrata
from torchbrdf.rendering.basis import render_basis
from torchbrdf.rendering.tables import render, render_tables
from torchbrdf.transport import DEFAULT_SAMPLES, plan_transport
from torchbrdf.transport._importance import Lobes, allocate, stratum_importance
from torchbrdf.transport.sampled import render_columns
from torchbrdf.transport.sampling import reflection
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView
from torchbrdf.view.view import View

SMALL = SphereView(12)


@pytest.fixture(scope="module")
def white() -> MerlTable:
    return MerlTable.from_function(lambda w_i, w_o: torch.full_like(w_i, 1 / pi), "white")


@pytest.fixture(scope="module")
def steel(tiny_tables: dict[str, MerlTable]) -> MerlTable:
    return tiny_tables["steel-0.15"]


class TestClosedForms:
    def test_white_furnace(self, white: MerlTable) -> None:
        view = SphereView(24)
        image = view.pack(render(white, LightProbe(torch.ones(3, 32, 64)), view))
        assert relative(image, torch.ones_like(image)) < 2e-3
        assert abs(float(image.mean()) - 1) < 2e-4

    def test_white_furnace_at_every_pixel(self, white: MerlTable) -> None:
        view = SphereView(16)
        image = view.pack(render(white, LightProbe(torch.ones(3, 32, 64)), view, samples=16384))
        assert float((image - 1).abs().max()) < 2e-3

    @pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.48, -0.6, 0.64)])
    @pytest.mark.parametrize(("degree", "factor"), [(0, pi), (1, 2 * pi / 3), (2, pi / 4), (3, 0.0)])
    def test_zonal_harmonics(
        self, white: MerlTable, axis: tuple[float, ...], degree: int, factor: float
    ) -> None:
        """[RH01]: under 1 + P_l / 2 a Lambertian sphere receives pi + A_l P_l / 2."""
        legendre = [lambda x: x**0, lambda x: x, lambda x: 1.5 * x**2 - 0.5, lambda x: 2.5 * x**3 - 1.5 * x][degree]
        probe = probe_of(lambda d: 1 + legendre(d @ torch.tensor(axis)) / 2)
        view = SphereView(16)
        irradiance = pi * view.pack(render(white, probe, view, samples=8192))
        u = (torch.arange(8) + 0.5) / 8
        grid = torch.cartesian_prod(u, u).T[:, None].expand(2, len(view.pixels), 64)
        normals = view.surface(view.pixels, *grid).normals
        cosine = torch.einsum("kqs,k->qs", normals, torch.tensor(axis))
        expected = (pi + factor * legendre(cosine) / 2).mean(1).expand(3, -1)
        assert relative(irradiance, expected) < 2e-3

    def test_small_light_gives_the_brdf_times_cosine(self, tiny_tables: dict[str, MerlTable]) -> None:
        table, view = tiny_tables["satin-0.5"], SphereView(16)
        light = torch.nn.functional.normalize(torch.tensor([0.5, 0.6, 0.62]), dim=0)
        probe = probe_of(lambda d: torch.where(d @ light > math.cos(0.02), 1.0, 0.0), 256)
        u = (torch.arange(8) + 0.5) / 8
        grid = torch.cartesian_prod(u, u).T[:, None].expand(2, len(view.pixels), 64)
        points = view.surface(view.pixels, *grid)
        normals, w_o = points.normals, points.view_dirs
        at = texel_directions(256)[probe.radiance[0] > 0]
        w_i = torch.nn.functional.normalize(at.mean(0), dim=0)[:, None, None].expand_as(normals)
        seen = reflection(normals, w_o, w_i)
        f_r = table.filled[seen.cells.long()]
        expected = (f_r * seen.cos_i[..., None]).mean(1).T * probe.total_power[:, None]
        lit = (normals * w_i).sum(0).amin(1) > 0.1  # away from the shadow line, where the lamp is not a point
        assert relative(view.pack(render(table, probe, view))[:, lit], expected[:, lit].float()) < 0.01


def quadrature(table: MerlTable, probe: LightProbe, view: View, pixel: int, fine: int = 12, places: int = 6) -> Tensor:
    """(3,) radiance of one pixel: a plain sum over fine^2 parts of every patch of texels and places^2 of the pixel."""
    height, width = probe.height, probe.width
    step = (torch.arange(fine) + 0.5) / fine
    x = (torch.arange(width)[:, None] + step).reshape(-1)
    y = (torch.arange(height - 1)[:, None] + step).reshape(-1)[:, None]
    w_i = directions_at(x, y, height, width).reshape(-1, 3)
    area = (torch.sin(y * (pi / (height - 1))) * (2 * pi / width) * (pi / (height - 1)) / fine**2).expand(-1, len(x))
    light = (probe.radiance_at(w_i) * area.reshape(-1, 1)).double()
    u = (torch.arange(places) + 0.5) / places
    total = torch.zeros(3, dtype=torch.float64)
    for place in torch.cartesian_prod(u, u):
        points = view.surface(view.pixels[pixel : pixel + 1], *place.reshape(2, 1, 1))
        seen = reflection(*(v.expand(3, 1, len(w_i)) for v in (points.normals, points.view_dirs)), w_i.T[:, None])
        total += (table.filled[seen.cells[0].long()] * seen.cos_i[0, :, None] * light).sum(0)
    return total / places**2


class TestOracle:
    @pytest.mark.parametrize("material", ["satin-0.35", "steel-0.15"])
    def test_plain_sum_over_the_probe(self, tiny_tables: dict[str, MerlTable], material: str) -> None:
        table, probe = tiny_tables[material], lamps(16)
        image = SMALL.pack(render(table, probe, SMALL, samples=16384))
        for pixel in (5, 40, 60):
            expected = quadrature(table, probe, SMALL, pixel)
            torch.testing.assert_close(image[:, pixel].double(), expected, rtol=5e-3, atol=0)

    def test_cells_are_those_of_the_table(self, steel: MerlTable) -> None:
        """`reflection` works in world space, `MerlTable.lookup` in the local frame."""
        g = torch.Generator().manual_seed(1)
        n, a, b = torch.nn.functional.normalize(torch.randn(3, 3, 4000, generator=g), dim=1)
        turn, _ = Rotation.align_vectors([[0, 0, 1]], [n[:, 0].tolist()])
        normal = n[:, :1].expand_as(n)
        seen = reflection(normal[:, None], a[:, None], b[:, None])
        to_local = torch.tensor(turn.as_matrix(), dtype=torch.float32)
        w_o, w_i = (to_local @ a).T, (to_local @ b).T
        expected = steel.lookup(w_i, w_o) * w_i[:, 2:].clamp_min(0)
        f_r_cos = steel.filled[seen.cells[0].long()] * seen.cos_i[0, :, None]
        close = torch.isclose(f_r_cos.float(), expected, rtol=1e-3, atol=1e-5).all(-1)
        assert float(close.float().mean()) > 0.995  # the others lie within rounding of a cell's border

    def test_no_light_is_lost_in_strata(self) -> None:
        probe = lamps()
        strata = LightStrata.build(probe, torch.Generator().manual_seed(0))
        emission = strata.radiance / strata.density
        power = (emission.view(3, len(strata), SIDE**2).mean(2) * strata.share).sum(1) * strata.unit
        torch.testing.assert_close(power.double(), probe.total_power, rtol=1e-3, atol=0)
        radiance, density, stratum = strata.seen(strata.directions)
        torch.testing.assert_close(radiance, strata.radiance, rtol=1e-2, atol=1e-3)
        own = torch.arange(len(strata)).repeat_interleave(SIDE**2)
        assert float((stratum == own).float().mean()) > 0.999
        assert float(((density / strata.density - 1).abs() < 0.01).float().mean()) > 0.999

    def test_strata_left_out_lie_below_the_horizon(self) -> None:
        strata = LightStrata.build(lamps(), torch.Generator().manual_seed(0))
        importance = stratum_importance(strata, Lobes.unknown(torch.device("cpu")), SMALL, SMALL.pixels)
        u = torch.linspace(0, 1, 5)
        grid = torch.cartesian_prod(u, u).T[:, None].expand(2, len(SMALL.pixels), 25)
        normals = SMALL.surface(SMALL.pixels, *grid).normals
        for pixel in range(0, len(SMALL.pixels), 9):
            highest = (normals[:, pixel].T @ strata.directions).amax(0).view(len(strata), -1).amax(1)
            assert not bool(((importance[pixel] == 0) & (highest > 0)).any())


class TestSymmetries:
    def test_linear_in_the_probe(self, steel: MerlTable) -> None:
        one, other = lamps(), probe_of(lambda d: 1 + d[..., 2], 32)
        both = LightProbe(one.radiance + 2 * other.radiance)
        total = render(steel, one, SMALL) + 2 * render(steel, other, SMALL)
        assert relative(render(steel, both, SMALL), total) < 5e-3

    @pytest.mark.parametrize("exponent", [-40, -27, 3, 27, 40])
    def test_powers_of_two_scale_exactly(self, tiny_library: MaterialLibrary, exponent: int) -> None:
        scale = 2.0**exponent
        reference = render_basis(tiny_library, lamps(), SMALL, samples=256).packed
        scaled = render_basis(tiny_library, lamps(scale=scale), SMALL, samples=256).packed
        assert torch.equal(scaled, reference * scale)

    def test_other_scales_change_nothing_else(self, steel: MerlTable) -> None:
        image = render(steel, lamps(), SMALL)
        assert relative(render(steel, lamps(scale=1e8), SMALL) / 1e8, image) < 5e-3
        assert relative(render(steel, lamps(scale=1e-8), SMALL) * 1e8, image) < 5e-3

    def test_turning_light_and_image_together(self, steel: MerlTable) -> None:
        quarter = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # about +Z, the view axis
        smooth = probe_of(lambda d: 1 + 0.8 * d[..., 0] + 0.5 * d[..., 1] ** 2, 64)
        image, turned = render(steel, smooth, SMALL), render(steel, smooth.rotated(quarter), SMALL)
        assert relative(turned, torch.rot90(image, 1, (1, 2))) < 5e-3
        assert relative(turned, image) > 0.05


class TestViews:
    def test_normal_map_of_a_sphere(self, steel: MerlTable) -> None:
        sphere = SphereView(32)
        shape = NormalMapView(sphere.normals, sphere.mask)
        inside = sphere.normals[2][None] > 0.5
        here, there = (render(steel, lamps(), view) * inside for view in (sphere, shape))
        assert relative(there, here) < 0.02

    def test_flat_normals(self, white: MerlTable) -> None:
        normals = torch.zeros(3, 4, 4)
        normals[2] = 1
        view = NormalMapView(normals, torch.ones(1, 4, 4, dtype=torch.bool))
        image = render(white, probe_of(lambda d: 1 + d[..., 2] / 2), view, samples=8192)
        assert relative(image, torch.full_like(image, (pi + pi / 3) / pi)) < 2e-3

    def test_narrow_perspective_is_nearly_orthographic(self, steel: MerlTable) -> None:
        here, there = render(steel, lamps(), SMALL), render(steel, lamps(), SphereView(12, fov_deg=1.0))
        assert relative(there, here) < 0.02
        assert relative(render(steel, lamps(), SphereView(12, fov_deg=60.0)), here) > 0.1

    def test_furnace_in_perspective(self, white: MerlTable) -> None:
        view = SphereView(12, fov_deg=60.0)
        image = view.pack(render(white, LightProbe(torch.ones(3, 16, 32)), view))
        assert relative(image, torch.ones_like(image)) < 2e-3


class TestBasis:
    def test_equals_the_rendering_of_a_table(self, tiny_tables: dict[str, MerlTable]) -> None:
        for name in ("red", "copper-0.08"):
            basis = render_basis(MaterialLibrary.from_tables([tiny_tables[name]]), lamps(), SMALL)
            image = render(tiny_tables[name], lamps(), SMALL)
            assert relative(basis.image(name), image) < 2e-3

    def test_several_tables_render_as_one_by_one(self, tiny_tables: dict[str, MerlTable]) -> None:
        """Samples go where the tables together need them, so the pictures agree to noise, not to rounding."""
        tables = [tiny_tables["red"], tiny_tables["steel-0.15"]]
        for together, table in zip(render_tables(tables, lamps(), SMALL, seed=4), tables, strict=True):
            assert relative_rms(together, render(table, lamps(), SMALL, seed=4), SMALL.mask) < 0.01

    def test_float16_keeps_the_small_weights_of_bright_cells(self, tiny_library: MaterialLibrary) -> None:
        """The same samples in float64: with one float16 bag a pixel, glossy columns lost a tenth."""
        columns = tiny_library.stored.columns
        plan = plan_transport(columns, lamps(), SMALL, 4096, 0)
        exact = torch.empty(3, len(SMALL.pixels), columns.shape[1], dtype=torch.float64)
        for chosen, transport in plan.blocks():
            for c, q in ((c, q) for c in range(3) for q in range(len(chosen))):
                exact[c, chosen[q]] = transport.weights[c, q].double() @ columns[transport.cells[q].long()].double()
        basis = render_basis(tiny_library, lamps(), SMALL, samples=4096).packed
        expected = (exact * plan.sampler.strata.unit * tiny_library.stored.scale).permute(2, 0, 1)
        error = (basis - expected).square().sum((1, 2)).sqrt() / expected.square().sum((1, 2)).sqrt().clamp_min(1e-30)
        assert float(error.max()) < 5e-4

    def test_samples_converge(self, tiny_library: MaterialLibrary) -> None:
        reference = render_basis(tiny_library, lamps(), SMALL, samples=16384, seed=7).packed
        errors = []
        for samples in (128, 1024, DEFAULT_SAMPLES):
            basis = render_basis(tiny_library, lamps(), SMALL, samples=samples).packed
            squares = (basis - reference).square().sum((1, 2)) / reference.square().sum((1, 2)).clamp_min(1e-30)
            errors.append(float(squares.sqrt().quantile(0.95)))
        assert errors[0] > 2 * errors[1] > 4 * errors[2]
        assert errors[2] < 5e-3

    def test_a_black_channel_stays_black(self, tiny_tables: dict[str, MerlTable]) -> None:
        black = MerlTable.from_function(lambda w_i, w_o: torch.zeros_like(w_i), "black")
        images = render_tables([black, tiny_tables["red"]], lamps(), SMALL)
        assert float(images[0].abs().max()) == 0
        assert relative(images[1], render(tiny_tables["red"], lamps(), SMALL)) < 2e-3
        assert float(render(black, lamps(), SMALL).abs().max()) == 0

    def test_reads_only_what_it_was_asked_for(self, tiny_library: MaterialLibrary) -> None:
        basis = render_basis(tiny_library.subset(["teal", "red"]), lamps(), SMALL, samples=256)
        whole = render_basis(tiny_library, lamps(), SMALL, samples=256)
        assert torch.equal(basis.packed, whole.subset(["teal", "red"]).packed)
        assert basis.packed.shape == (6, 3, len(SMALL.pixels))


class TestRandomness:
    def test_seeds(self, tiny_library: MaterialLibrary) -> None:
        one, again, other = (
            render_basis(tiny_library, lamps(), SMALL, samples=256, seed=seed).packed for seed in (3, 3, 4)
        )
        assert torch.equal(one, again)
        assert not torch.equal(one, other)
        assert relative(one, other) < 0.1

    def test_neither_threads_nor_blocks_matter(
        self, tiny_library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        reference = render_basis(tiny_library, lamps(), SMALL, samples=512).packed
        threads = torch.get_num_threads()
        monkeypatch.setattr("torchbrdf.transport.sampled._BLOCK", 1 << 11)
        try:
            torch.set_num_threads(1 if threads > 1 else 2)
            assert torch.equal(render_basis(tiny_library, lamps(), SMALL, samples=512).packed, reference)
        finally:
            torch.set_num_threads(threads)

    def test_the_mean_of_seeds_is_unbiased(self, steel: MerlTable, monkeypatch: pytest.MonkeyPatch) -> None:
        """Few samples and many seeds against many samples: a bias would stay. Of few points of light, too."""
        for module in ("light.strata", "transport.sampling"):
            monkeypatch.setattr(f"torchbrdf.{module}.SIDE", 4)
        view = SphereView(8)
        images = torch.stack([render(steel, lamps(), view, samples=32, seed=seed) for seed in range(100)])
        reference = render(steel, lamps(), view, samples=16384, seed=1000)
        noise = float((images.var(0).sum() / len(images) / reference.square().sum()).sqrt())
        assert relative(images.mean(0), reference) < 1.5 * noise + 1e-3

    def test_allocation(self) -> None:
        variance = torch.tensor([[1.0, 0.0], [4.0, 0.0], [0.0, 10000.0], [0.0, 0.0]])
        counts = allocate(variance, torch.tensor([1.0, 1.0]).double(), 1024, 256, 1 << 15)
        assert counts.float().mean() <= 1024
        assert counts.tolist() == [*sorted(counts[:3].tolist()), 256]
        assert all(count & (count - 1) == 0 for count in counts.tolist())

    @pytest.mark.parametrize("samples", [2, 3, 9, 100])
    def test_few_samples(self, tiny_library: MaterialLibrary, samples: int) -> None:
        assert bool(torch.isfinite(render_basis(tiny_library, lamps(), SMALL, samples=samples).packed).all())


def test_progress_counts_what_takes_the_time(tiny_library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples: the pixels that have most come last, and nine in ten are done at half the time."""
    bars = MagicMock()
    monkeypatch.setattr("torchbrdf.transport.sampled.progress_bar", bars)
    columns, probe = tiny_library.stored.columns, LightProbe.default(32)
    render_columns(columns, probe, SMALL, 256, seed=0)
    drawn = int(plan_transport(columns, probe, SMALL, 256, seed=0).counts.sum())
    updates = bars.return_value.__enter__.return_value.update.call_args_list
    assert drawn > 2 * len(SMALL.pixels)
    assert bars.call_args.kwargs["total"] == sum(each.args[0] for each in updates) == drawn


class TestBadInput:
    def test_backend(self, tiny_library: MaterialLibrary) -> None:
        expected = r'^backend must be "auto", "sampled", "harmonic" or "mitsuba", got \'guess\'$'
        with pytest.raises(ValueError, match=expected):
            render_basis(tiny_library, lamps(), SMALL, backend="guess")

    @pytest.mark.parametrize("samples", [1, 0, -5])
    def test_samples(self, tiny_library: MaterialLibrary, white: MerlTable, samples: int) -> None:
        message = f"^the transport needs at least 2 samples a pixel, got {samples}$"
        with pytest.raises(ValueError, match=message):
            render_basis(tiny_library, lamps(), SMALL, samples=samples)
        with pytest.raises(ValueError, match=message):
            render(white, lamps(), SMALL, samples=samples)

    @pytest.mark.parametrize(("samples", "got"), [(16.5, "16.5"), ("16", "'16'"), ([16], "a list")])
    def test_samples_that_are_no_whole_number(self, white: MerlTable, samples: object, got: str) -> None:
        with pytest.raises(ValueError, match=rf"^samples must be a whole number, got {got}$"):
            render(white, lamps(), SMALL, samples=samples)

    def test_samples_of_another_type(self, white: MerlTable) -> None:
        pictures = [render(white, lamps(), SMALL, samples=samples) for samples in (16, torch.tensor(16))]
        assert torch.equal(*pictures)

    def test_no_table(self) -> None:
        with pytest.raises(ValueError, match=r"^render_tables needs at least one table, got none$"):
            render_tables([], lamps(), SMALL)
