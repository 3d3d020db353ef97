"""The plugin `merl`: its values are the table's, its samples follow its pdf, and it works in any Mitsuba scene."""

import subprocess
import sys
from math import cos, pi, radians, sin

import numpy as np
import pytest
import torch
from torch.nn.functional import normalize

from materials import lambert
from torchbrdf.brdf.directions import from_half_difference
from torchbrdf.brdf.merl import GRID, MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.mitsuba_backend import merl_bsdf
from torchbrdf.mitsuba_backend.merl_plugin import register_merl
from torchbrdf.mitsuba_backend.scenes import MitsubaScene
from torchbrdf.view.sphere import SphereView

FRACTIONS = [0.0, 0.5, 0.9]
VIEW_ANGLES = [0, 20, 50, 75, 87]
SCENE = """<scene version="3.0.0">
    <integrator type="direct"/>
    <sensor type="orthographic">
        <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="4"/><integer name="height" value="4"/>
            <string name="pixel_format" value="rgb"/><rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere"><float name="radius" value="3"/>
        <bsdf type="merl">
            <string name="filename" value="{filename}"/>
            <string name="interpolation" value="linear"/>
            <float name="half_vector_fraction" value="0.25"/>
        </bsdf>
    </shape>
</scene>"""


@pytest.fixture(scope="module")
def noise() -> MerlTable:
    """Every cell above the horizon has values of its own; a third of the cells was not measured."""
    generator = torch.Generator().manual_seed(3)
    values = torch.rand(*GRID, 3, generator=generator) + 0.01
    return MerlTable(values.double(), torch.rand(*GRID, generator=generator) > 1 / 3, "noise")


@pytest.fixture(scope="module")
def ramp() -> MerlTable:
    """Changes slowly from cell to cell, unlike in its channels, and fast enough that a cell more or less shows."""
    h, d, p = (torch.arange(n, dtype=torch.float64) for n in GRID)
    base = torch.cos(h / 4)[:, None, None] + torch.cos(d / 3)[:, None]
    values = torch.stack([base + shift + torch.cos(2 * pi * (p + 0.5) / GRID[2] + shift) for shift in (3.5, 4, 5)], -1)
    return MerlTable(values, torch.ones(GRID, dtype=torch.bool), "ramp")


@pytest.fixture(scope="module")
def grey() -> MerlTable:
    """Lambert of albedo 0.75, 0.5 and 0.25."""
    return MerlTable.from_function(lambert(0.75, 0.5, 0.25), "grey")


def interaction(mi, wi):
    """Local directions (N, 3) as interactions whose frame is the world's."""
    import drjit as dr

    found = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    found.wi = vector(mi, wi)
    found.n = found.sh_frame.n = mi.Normal3f(0, 0, 1)
    return found


def vector(mi, directions):
    """(N, 3) as a Mitsuba vector; one alone in scalar variants."""
    if mi.variant().startswith("scalar"):
        return mi.Vector3f(*directions[0].tolist())
    return mi.Vector3f(*(mi.Float(column.float().contiguous()) for column in directions.T))


def tensor(values):
    """(N,) or (N, 3) float32 of a Mitsuba array."""
    import drjit as dr

    found = torch.from_numpy(np.array(values, dtype=np.float32))
    return found.T if dr.depth_v(values) > 1 else found


def evaluated(mi, bsdf, wi, wo):
    """(N, 3): values with their cosines."""
    if mi.variant().startswith("scalar"):
        pairs = zip(wi.split(1), wo.split(1), strict=True)
        found = [bsdf.eval(mi.BSDFContext(), interaction(mi, a), vector(mi, b)) for a, b in pairs]
        return torch.tensor([list(map(float, value)) for value in found])
    return tensor(bsdf.eval(mi.BSDFContext(), interaction(mi, wi), vector(mi, wo)))


def random_directions(n, seed):
    """(n, 3) float32 over the upper hemisphere."""
    directions = torch.randn(n, 3, generator=torch.Generator().manual_seed(seed))
    directions[:, 2].abs_()
    return normalize(directions, dim=1)


def inside_cells(n, seed, lowest_row=2):
    """Pairs (n, 3) float32 above the horizon that keep a tenth of a cell from every border, turned at random."""
    generator = torch.Generator().manual_seed(seed)
    h, d, p, turn = torch.rand(4, 4 * n, generator=generator, dtype=torch.float64)
    h, d, p = (
        torch.floor(low + x * (count - low)) + 0.1 + 0.8 * torch.rand(4 * n, generator=generator, dtype=torch.float64)
        for x, low, count in ((h, lowest_row, 90), (d, 1, 90), (p, 0, 360))
    )
    w_i, w_o = from_half_difference((h / 90) ** 2 * pi / 2, d * pi / 180, p * pi / 180)
    c, s = torch.cos(2 * pi * turn), torch.sin(2 * pi * turn)
    w_i, w_o = (torch.stack([c * w[:, 0] - s * w[:, 1], s * w[:, 0] + c * w[:, 1], w[:, 2]], 1) for w in (w_i, w_o))
    seen = (w_i[:, 2] > 0.01) & (w_o[:, 2] > 0.01)
    return w_i[seen][:n].float(), w_o[seen][:n].float()


def in_plane(n):
    """Pairs (n, 3) float32 in planes of incidence, where phi_d is 0 or 180 degrees but for rounding."""
    generator = torch.Generator().manual_seed(5)
    azimuth, first, second = torch.rand(3, n, generator=generator, dtype=torch.float64)

    def direction(theta):
        across = torch.sin(theta)
        return torch.stack([across * torch.cos(azimuth * 7), across * torch.sin(azimuth * 7), torch.cos(theta)], 1)

    return direction(0.1 + 1.2 * first).float(), direction(0.1 - second).float()


# Values


def test_nearest_is_the_tables_lookup_times_cosine(mitsuba, noise):
    wi, wo = inside_cells(20_000, 0)
    found = evaluated(mitsuba, mitsuba.load_dict(merl_bsdf(noise)), wi, wo)
    torch.testing.assert_close(found, noise.lookup(wi, wo) * wo[:, 2:], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("pairs", ["any", "in the plane of incidence", "reflected back", "mirrored"])
def test_linear_is_the_tables_lookup_times_cosine(mitsuba, ramp, pairs):
    wi, wo = random_directions(40_000, 1), random_directions(40_000, 2)
    if pairs == "in the plane of incidence":
        wi, wo = in_plane(5000)
    elif pairs == "reflected back":
        wo = normalize(wi + 0.03 * random_directions(40_000, 3), dim=1)
    elif pairs == "mirrored":
        wo = normalize(wi * torch.tensor([-1.0, -1.0, 1.0]) + 0.03 * random_directions(40_000, 3), dim=1)
    found = evaluated(mitsuba, mitsuba.load_dict(merl_bsdf(ramp, "linear")), wi, wo)
    expected = ramp.lookup(wi.double(), wo.double(), "linear").float() * wo[:, 2:]
    torch.testing.assert_close(found, expected, rtol=0, atol=5e-3)


@pytest.mark.parametrize("interpolation", ["nearest", "linear"])
def test_near_the_normal_only_cells_of_the_peak_are_read(mitsuba, interpolation):
    """phi_d is lost to rounding there; whatever it is, rows and columns stay the first ones."""
    values = torch.zeros(*GRID, 3, dtype=torch.float64)
    values[:3, :3] = 1
    table = MerlTable(values, torch.ones(GRID, dtype=torch.bool), "peak")
    wi, wo = (normalize(d * torch.tensor([1e-4, 1e-4, 1]), dim=1) for d in (in_plane(5000)))
    found = evaluated(mitsuba, mitsuba.load_dict(merl_bsdf(table, interpolation)), wi, wo)
    torch.testing.assert_close(found, wo[:, 2:].expand(-1, 3))


@pytest.mark.parametrize("interpolation", ["nearest", "linear"])
def test_scalar_and_llvm_agree(mitsuba, ramp, interpolation):
    wi, wo = inside_cells(300, 4)
    flat_i, flat_o = in_plane(60)
    wi = torch.cat([wi, flat_i]) if interpolation == "linear" else wi
    wo = torch.cat([wo, flat_o]) if interpolation == "linear" else wo
    fast = evaluated(mitsuba, mitsuba.load_dict(merl_bsdf(ramp, interpolation)), wi, wo)
    mitsuba.set_variant("scalar_rgb")
    bsdf = mitsuba.load_dict(merl_bsdf(ramp, interpolation))
    slow = evaluated(mitsuba, bsdf, wi, wo)
    torch.testing.assert_close(slow, fast, rtol=1e-3, atol=1e-3)
    assert fast.std() > 0.1

    sample, _ = bsdf.sample(mitsuba.BSDFContext(), interaction(mitsuba, wi[:1]), 0.2, mitsuba.Point2f(0.3, 0.6))
    wo = torch.tensor([list(map(float, sample.wo))])
    mitsuba.set_variant("llvm_ad_rgb")
    bsdf = mitsuba.load_dict(merl_bsdf(ramp, interpolation))
    other, _ = bsdf.sample(mitsuba.BSDFContext(), interaction(mitsuba, wi[:1]), 0.2, mitsuba.Point2f(0.3, 0.6))
    torch.testing.assert_close(tensor(other.wo), wo, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(float(other.pdf[0]), float(sample.pdf), rtol=1e-4, atol=0)


def test_scalar_and_llvm_render_the_same(mitsuba, ramp):
    view, probe = SphereView(6), LightProbe.default(16)
    fast = MitsubaScene(view, probe, ramp).render(2048)
    mitsuba.set_variant("scalar_rgb")
    slow = MitsubaScene(view, probe, ramp).render_halves(64)
    assert slow.image.mean() == pytest.approx(float(fast.mean()), rel=4 * slow.noise / len(view.pixels) ** 0.5)


@pytest.mark.parametrize("interpolation", ["nearest", "linear"])
def test_reciprocity(mitsuba, noise, interpolation):
    wi, wo = inside_cells(5000, 6)
    bsdf = mitsuba.load_dict(merl_bsdf(noise, interpolation))
    forth, back = evaluated(mitsuba, bsdf, wi, wo) / wo[:, 2:], evaluated(mitsuba, bsdf, wo, wi) / wi[:, 2:]
    torch.testing.assert_close(forth, back, rtol=2e-3, atol=1e-4)


def test_below_the_horizon_all_is_zero(mitsuba, grey):
    up, down = torch.tensor([[0.6, 0.0, 0.8]]), torch.tensor([[0.6, 0.0, -0.8]])
    bsdf = mitsuba.load_dict(merl_bsdf(grey))
    for wi, wo in ((up, down), (down, up), (down, down)):
        value, pdf = bsdf.eval_pdf(mitsuba.BSDFContext(), interaction(mitsuba, wi), vector(mitsuba, wo))
        assert not tensor(value).any()
        assert not tensor(pdf).any()
    _, weight = bsdf.sample(mitsuba.BSDFContext(), interaction(mitsuba, down), 0.7, mitsuba.Point2f(0.4, 0.4))
    assert not tensor(weight).any()


# Sampling


def bsdf_with(mi, table, fraction):
    return mi.load_dict({**merl_bsdf(table), "half_vector_fraction": fraction})


def direction(degrees):
    return torch.tensor([[sin(radians(degrees)), 0.0, cos(radians(degrees))]])


class HalfVectorDomain:
    """Directions wo by (u, phi) of the half vector, theta_h = u^2 pi/2: there the density has no singularity.

    d omega_o = 4 cos(theta_d) sin(theta_h) pi u du dphi. Directions whose half vector lies below the horizon of wi
    are below the horizon themselves. Below u = LEAST float32 does not hold the azimuth of h at grazing angles.
    """

    LEAST = 0.02

    def __init__(self, mi, wi):
        self.mi = mi
        self.wi = mi.ScalarVector3f(*wi[0].tolist())

    def bounds(self):
        return self.mi.ScalarBoundingBox2f([self.LEAST, -pi], [1, pi])

    def aspect(self):
        return 0.5

    def map_forward(self, p):
        import drjit as dr

        mi = self.mi
        sin_h, cos_h = dr.sincos(p.x * p.x * (pi / 2))
        sin_p, cos_p = dr.sincos(p.y)
        h = mi.Vector3f(sin_h * cos_p, sin_h * sin_p, cos_h)
        return 2 * dr.dot(h, mi.Vector3f(self.wi)) * h - mi.Vector3f(self.wi)

    def map_backward(self, wo):
        import drjit as dr

        h = dr.normalize(wo + self.mi.Vector3f(self.wi))
        theta = dr.atan2(dr.sqrt(h.x * h.x + h.y * h.y), h.z)
        return self.mi.Vector2f(dr.sqrt(theta * (2 / pi)), dr.atan2(h.y, h.x))

    def jacobian(self, wo):
        import drjit as dr

        s = wo + self.mi.Vector3f(self.wi)
        sin_s = dr.sqrt(s.x * s.x + s.y * s.y)  # |s| = 2 cos(theta_d), sin_s = |s| sin(theta_h)
        return 2 * sin_s * pi * self.map_backward(wo).x


def chi_square(mi, bsdf, wi, claimed=None, bend=lambda pdf, wo: pdf):
    """Mitsuba's test, run: of the samples of one BSDF against the pdf of another or a bent one."""
    import drjit as dr
    from mitsuba.chi2 import ChiSquareTest

    domain, claimed = HalfVectorDomain(mi, wi), claimed or bsdf
    context = mi.BSDFContext()

    def sample(numbers):
        si = interaction(mi, wi)
        found, _ = bsdf.sample(context, si, numbers[0], mi.Point2f(numbers[1], numbers[2]))
        usable = (found.pdf > 0) & (found.wo.z > 0) & (domain.map_backward(found.wo).x >= domain.LEAST)
        elsewhere = domain.map_forward(mi.Point2f(0.5, 0))
        return dr.select(usable, found.wo, elsewhere), dr.select(usable, mi.Float(1), 0)

    def pdf(wo):
        found = claimed.pdf(context, interaction(mi, wi), wo) * domain.jacobian(wo)
        return bend(dr.select(wo.z > 0, found, 0), wo)

    test = ChiSquareTest(domain, sample, pdf, sample_dim=3, sample_count=400_000, res=61, ires=8, seed=1)
    return test.run(0.001 / (len(FRACTIONS) * len(VIEW_ANGLES))), test


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize("angle", VIEW_ANGLES)
def test_samples_follow_the_pdf(mitsuba, grey, capsys, monkeypatch, tmp_path, fraction, angle):
    monkeypatch.chdir(tmp_path)
    passed, test = chi_square(mitsuba, bsdf_with(mitsuba, grey, fraction), direction(angle))
    capsys.readouterr()
    assert passed, test.messages


@pytest.mark.parametrize("angle", [0, 50, 87])
def test_the_chi_square_test_fails_for_a_wrong_pdf(mitsuba, grey, capsys, monkeypatch, tmp_path, angle):
    monkeypatch.chdir(tmp_path)  # a test that fails leaves a file
    bsdf, wi = bsdf_with(mitsuba, grey, 0.5), direction(angle)
    assert not chi_square(mitsuba, bsdf, wi, claimed=bsdf_with(mitsuba, grey, 0.44))[0]
    assert not chi_square(mitsuba, bsdf, wi, bend=lambda pdf, wo: pdf * (1 + 0.15 * wo.y))[0]
    capsys.readouterr()


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize("angle", VIEW_ANGLES)
def test_the_pdf_integrates_to_the_share_of_valid_samples(mitsuba, grey, fraction, angle):
    n, wi = 1500, direction(angle)
    bsdf, domain = bsdf_with(mitsuba, grey, fraction), HalfVectorDomain(mitsuba, wi)
    u, phi = torch.cartesian_prod((torch.arange(n) + 0.5) / n, ((torch.arange(n) + 0.5) / n - 0.5) * 2 * pi).T
    wo = domain.map_forward(mitsuba.Point2f(mitsuba.Float(u.contiguous()), mitsuba.Float(phi.contiguous())))
    density = tensor(bsdf.pdf(mitsuba.BSDFContext(), interaction(mitsuba, wi), wo) * domain.jacobian(wo))
    integral = float(density.double().mean()) * 2 * pi

    chooses, x, y = (mitsuba.Float(row.contiguous()) for row in torch.quasirandom.SobolEngine(3).draw(1 << 18).T)
    sample, _ = bsdf.sample(mitsuba.BSDFContext(), interaction(mitsuba, wi), chooses, mitsuba.Point2f(x, y))
    assert integral == pytest.approx(float((tensor(sample.pdf) > 0).double().mean()), abs=1e-3)


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize("interpolation", ["nearest", "linear"])
def test_weight_is_value_over_pdf(mitsuba, ramp, fraction, interpolation):
    bsdf = mitsuba.load_dict({**merl_bsdf(ramp, interpolation), "half_vector_fraction": fraction})
    si, context = interaction(mitsuba, random_directions(5000, 7)), mitsuba.BSDFContext()
    chooses, x, y = (mitsuba.Float(row.contiguous()) for row in torch.rand(3, 5000, generator=torch.manual_seed(0)))
    sample, weight = bsdf.sample(context, si, chooses, mitsuba.Point2f(x, y))
    value, pdf = bsdf.eval(context, si, sample.wo), bsdf.pdf(context, si, sample.wo)
    both = bsdf.eval_pdf(context, si, sample.wo)
    torch.testing.assert_close(tensor(both[0]), tensor(value))
    torch.testing.assert_close(tensor(both[1]), tensor(pdf))
    torch.testing.assert_close(tensor(sample.pdf), tensor(pdf), rtol=1e-3, atol=0)
    valid = tensor(pdf) > 0
    assert 0.5 < valid.double().mean() <= 1
    expected = torch.where(valid[:, None], tensor(value) / tensor(pdf)[:, None], 0)
    torch.testing.assert_close(tensor(weight), expected, rtol=1e-3, atol=1e-6)
    assert torch.isfinite(tensor(weight)).all()
    assert bool((tensor(sample.eta) == 1).all())


# In scenes


def test_traverse_swaps_the_table_and_compiles_nothing(mitsuba, ramp, grey):
    import drjit as dr

    scene = MitsubaScene(SphereView(6), LightProbe.default(16), ramp)
    first = scene.render(32)
    kernels = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for table in (grey, ramp, grey):
            dr.kernel_history_clear()
            scene.set_table(table)
            swapped = scene.render(32)
            history = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
            kernels.append({entry["hash"] for entry in history})
            if len(kernels) > 1:  # the first swap of a process compiles a small kernel that copies
                assert all(entry["cache_hit"] and not entry["cache_disk"] for entry in history)
            if table is ramp:
                torch.testing.assert_close(swapped, first)
    assert kernels[0] >= kernels[1] == kernels[2] != set()
    assert not torch.equal(swapped, first)
    torch.testing.assert_close(swapped, MitsubaScene(SphereView(6), LightProbe.default(16), grey).render(32))


def test_traverse_shows_the_table_and_takes_a_new_one(mitsuba, ramp, noise):
    bsdf = mitsuba.load_dict(merl_bsdf(ramp))
    parameters = mitsuba.traverse(bsdf)
    assert tuple(parameters["values"].shape) == (*GRID, 3)
    np.testing.assert_allclose(np.array(parameters["values"]).reshape(-1, 3), ramp.filled.float())
    parameters["values"] = mitsuba.TensorXf(noise.filled.float().reshape(*GRID, 3).numpy())
    parameters.update()
    wi, wo = inside_cells(1000, 8)
    torch.testing.assert_close(evaluated(mitsuba, bsdf, wi, wo), noise.lookup(wi, wo) * wo[:, 2:], rtol=1e-5, atol=1e-7)
    parameters["values"] = mitsuba.TensorXf(np.zeros((3, 90, 90, 180), np.float32))
    with pytest.raises(ValueError, match=r"^merl: values must be \(90, 90, 180, 3\), got \(3, 90, 90, 180\)$"):
        parameters.update()


def test_a_file_in_two_lines_in_a_users_scene(tmp_path, mitsuba, grey):
    """A process of its own, the scalar variant, an .xml file with the .binary beside it."""
    grey.save(tmp_path / "grey.binary")
    (tmp_path / "scene.xml").write_text(SCENE.format(filename="grey.binary"))
    script = (
        'import mitsuba as mi; mi.set_variant("scalar_rgb")\n'
        "import torchbrdf.mitsuba_backend\n"
        "torchbrdf.mitsuba_backend.register_merl()\n"
        f"image = mi.render(mi.load_file({str(tmp_path / 'scene.xml')!r}), spp=64)\n"
        "import numpy; print(*numpy.array(image).mean((0, 1)))"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd="/", capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert [float(word) for word in done.stdout.split()] == pytest.approx([0.75, 0.5, 0.25], rel=0.03)


def test_a_file_gives_the_values_of_its_table(tmp_path, mitsuba, noise):
    noise.save(tmp_path / "noise.binary")
    register_merl()
    register_merl()
    bsdf = mitsuba.load_dict({"type": "merl", "filename": str(tmp_path / "noise.binary")})
    wi, wo = inside_cells(2000, 9)
    torch.testing.assert_close(evaluated(mitsuba, bsdf, wi, wo), noise.lookup(wi, wo) * wo[:, 2:], rtol=1e-5, atol=1e-7)


def test_xml(tmp_path, mitsuba, grey):
    grey.save(tmp_path / "grey.binary")
    register_merl()
    scene = mitsuba.load_string(SCENE.format(filename=tmp_path / "grey.binary"))
    assert "interpolation=linear" in str(scene)
    assert "half_vector_fraction=0.25" in str(scene)
    image = np.array(mitsuba.render(scene, spp=256))
    np.testing.assert_allclose(image.mean((0, 1)), [0.75, 0.5, 0.25], rtol=0.02)


def test_a_sheet_with_two_sides(mitsuba, grey):
    bsdf = mitsuba.load_dict({"type": "twosided", "bsdf": merl_bsdf(grey)})
    down = torch.tensor([[0.6, 0.0, -0.8]])
    found = evaluated(mitsuba, bsdf, down, down)
    torch.testing.assert_close(found, torch.tensor([[0.75, 0.5, 0.25]]) / pi * 0.8)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({}, 'ValueError: merl: give either "filename", a MERL .binary file, or "values", a tensor (90, 90, 180, 3)'),
        ({"filename": "absent.binary"}, "absent.binary: no such file; expected a MERL .binary table"),
        ({"filename": "bad.binary"}, "bad.binary: not a MERL table: the header must be (90, 90, 180), got b'hello'"),
        ({"interpolation": "cubic"}, "ValueError: merl: interpolation must be \"nearest\" or \"linear\", got 'cubic'"),
        ({"half_vector_fraction": 1.0}, "ValueError: merl: half_vector_fraction must be in [0, 1), got 1.0"),
        ({"half_vector_fraction": -0.1}, "ValueError: merl: half_vector_fraction must be in [0, 1), got -0.1"),
        ({"half_vector_fraction": float("nan")}, "ValueError: merl: half_vector_fraction must be in [0, 1), got nan"),
        ({"values": (3, 90, 90, 180)}, "ValueError: merl: values must be (90, 90, 180, 3), got (3, 90, 90, 180)"),
        ({"interpolatoin": "linear"}, '  - string "interpolatoin": "linear"'),
    ],
)
def test_bad_parameters_end_in_one_clear_line(tmp_path, mitsuba, grey, parameters, expected):
    (tmp_path / "bad.binary").write_bytes(b"hello")
    register_merl()
    description = merl_bsdf(grey) if "filename" not in parameters and parameters else {"type": "merl"}
    if "filename" in parameters:
        parameters = {"filename": str(tmp_path / parameters["filename"])}
    if "values" in parameters:
        parameters = {"values": mitsuba.TensorXf(np.zeros(parameters["values"], np.float32))}
    with pytest.raises(RuntimeError) as caught:
        mitsuba.load_dict({**description, **parameters})
    assert str(caught.value).splitlines()[-1].endswith(expected)


def test_a_file_and_values_at_once_are_refused_clearly(tmp_path, mitsuba, grey):
    grey.save(tmp_path / "grey.binary")
    with pytest.raises(RuntimeError, match=r'merl: give either "filename".* or "values"'):
        mitsuba.load_dict({**merl_bsdf(grey), "filename": str(tmp_path / "grey.binary")})


def test_merl_bsdf_refuses_an_unknown_interpolation_at_once(mitsuba, grey):
    with pytest.raises(ValueError, match=r"^[^\n]*interpolation must be \"nearest\" or \"linear\", got 'cubic'$"):
        merl_bsdf(grey, "cubic")


# Closed forms


@pytest.mark.parametrize(
    ("integrator", "fraction"),
    [({"type": "direct", "bsdf_samples": 0, "emitter_samples": 1}, 0.5), ({"type": "path", "max_depth": 3}, 0.0)],
)
def test_a_lambert_table_is_diffuse_to_rounding(mitsuba, grey, integrator, fraction):
    view, probe = SphereView(12), LightProbe.default(32)
    reference = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.75, 0.5, 0.25]}}
    ours = {**merl_bsdf(grey), "half_vector_fraction": fraction}
    images = [MitsubaScene(view, probe, bsdf, integrator).render(64, seed=5) for bsdf in (ours, reference)]
    assert images[1].mean() > 0.01
    torch.testing.assert_close(*images, rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize("integrator", ["direct", "path"])
def test_white_furnace(mitsuba, fraction, integrator):
    """Every pixel sees a white surface in white light: radiance 1, within the noise of its two halves."""
    white = MerlTable.from_function(lambert(1.0, 1.0, 1.0), "white")
    view, probe = SphereView(8), LightProbe(torch.ones(3, 8, 16))
    bsdf = {**merl_bsdf(white), "half_vector_fraction": fraction}
    halves = MitsubaScene(view, probe, bsdf, {"type": integrator}).render_halves(2048)
    packed = view.pack(halves.image)
    assert (packed - 1).square().mean().sqrt() < 1.5 * halves.noise + 1e-5
    assert packed.mean() == pytest.approx(1, abs=4 * halves.noise / len(view.pixels) ** 0.5 + 1e-5)


def test_the_furnace_sees_energy_that_is_missing(mitsuba):
    """A mirror-like table that reflects a known share, by quadrature over the same grid."""
    table = MerlTable.from_function(
        lambda w_i, w_o: (400 * (normalize(w_i + w_o, dim=-1)[..., 2:] ** 3000)).expand(-1, 3) / 4, "sharp"
    )
    scene = MitsubaScene(SphereView(8), LightProbe(torch.ones(3, 8, 16)), merl_bsdf(table))
    halves = scene.render_halves(4096)
    theta, phi = torch.cartesian_prod((torch.arange(1500) + 0.5) / 1500, (torch.arange(8) + 0.5) * (pi / 4)).double().T
    theta_h = theta**2 * pi / 2
    view = SphereView(8)
    n_z = view.pack(view.normals)[2].double()
    expected = []
    for z in n_z:
        w_o = torch.tensor([float((1 - z * z).sqrt()), 0.0, float(z)], dtype=torch.float64).expand(len(theta), 3)
        across = torch.sin(theta_h)
        h = torch.stack([across * torch.cos(phi), across * torch.sin(phi), torch.cos(theta_h)], 1)
        cos_d = (h * w_o).sum(1, keepdim=True)
        w_i = 2 * cos_d * h - w_o
        area = 4 * cos_d[:, 0] * across * pi * theta * 2 * pi
        expected.append((table.lookup(w_i, w_o)[:, 0] * w_i[:, 2] * area).mean())
    torch.testing.assert_close(
        view.pack(halves.image)[0].double().mean(), torch.stack(expected).mean(), rtol=0.05, atol=0
    )
