import csv
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
import torch

import torchbrdf as tb
from torchbrdf.estimation.solvers.ridge_regression import prior_mean

MATERIALS = 8
PROBES = 2


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return import_module("leave_one_out")


def analytic_table(i: int) -> tb.MerlTable:
    """A diffuse part and a lobe around the half vector, both different for every material and channel."""
    generator = torch.Generator().manual_seed(i)
    albedo, strength, u = torch.rand(3, 3, generator=generator, dtype=torch.float64)
    exponent = torch.exp2(2 + 5 * u)

    def f_r(w_i: torch.Tensor, w_o: torch.Tensor) -> torch.Tensor:
        h = torch.nn.functional.normalize(w_i + w_o, dim=-1)[..., 2:]
        return 0.3 * albedo + 2 * strength * h**exponent

    return tb.MerlTable.from_function(f_r, f"material-{i}")


@pytest.fixture(scope="module")
def tables() -> list[tb.MerlTable]:
    return [analytic_table(i) for i in range(MATERIALS)]


@pytest.fixture(scope="module")
def library(tables: list[tb.MerlTable]) -> tb.MaterialLibrary:
    """The last material is the mean of the two before it."""
    mean = tb.MerlTable((tables[-1].values + tables[-2].values) / 2, tables[-1].valid, "mean")
    return tb.MaterialLibrary.from_tables([*tables, mean])


@pytest.fixture(scope="module")
def probes() -> dict[str, tb.LightProbe]:
    noise = torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(5)) ** 8
    return {"default": tb.LightProbe.default(32), "noise": tb.LightProbe(noise)}


@pytest.fixture(scope="module")
def bases(library: tb.MaterialLibrary, probes: dict[str, tb.LightProbe]) -> list[tb.BasisImages]:
    return [tb.render_basis(library, probe, tb.SphereView(12), samples=64) for probe in probes.values()]


def experiment(script: ModuleType, library: tb.MaterialLibrary, bases: list[tb.BasisImages], methods: list[str]):
    """Targets are the basis images themselves: no rendering noise."""
    light, lit = script.directional_scene(library, tb.SphereView(12), 0)
    return script.Experiment(
        library=library,
        bases=bases,
        scenes=[script.Scene.of(f"probe {i}", basis.packed) for i, basis in enumerate(bases)],
        targets=[torch.stack([basis.packed[c::3, c] for c in range(3)], dim=1) for basis in bases],
        lights=[light, light],
        lit=[lit, lit],
        cells=script.CellSample.of(library, 0),
        reference=tb.MaterialClasses.fit(library, 2).labels,
        noise=[0, 2],
        methods=[script.Method.named(name) for name in methods],
        n_classes=2,
        seed=0,
    )


def test_methods_have_names(script: ModuleType) -> None:
    names = ["naive", "paper", "auto", "single-0.05", "classes-1e-3", "classes-0", "single-0"]
    found = [script.Method.named(name).name for name in names]
    assert found == ["naive", "classes-0.5", "auto", "single-0.05", "classes-0.001", "classes-0", "naive"]


@pytest.mark.parametrize("name", ["best", "single", "single-", "classes--1", "classes-nan", "classes-inf", "two-0.5"])
def test_other_methods_are_refused(script: ModuleType, name: str) -> None:
    message = f"^method must be naive, paper, auto, single-X or classes-X with a number X >= 0, got '{name}'$"
    with pytest.raises(ValueError, match=message):
        script.Method.named(name)


def test_scene_error_is_the_error_over_pixels(script: ModuleType, bases: list[tb.BasisImages]) -> None:
    scene = script.Scene.of("", bases[0].packed)
    generator = torch.Generator().manual_seed(0)
    weights = torch.randn(2, 4, 3, bases[0].n, generator=generator, dtype=torch.float64)
    y = torch.rand(2, 3, bases[0].packed.shape[-1], generator=generator, dtype=torch.float64)
    found = scene.error(weights, script.Images(*(x[:, None] for x in vars(scene.project(y)).values())))
    fitted = torch.einsum("ncp,abcn->abcp", bases[0].packed.double(), weights)
    expected = (fitted - y[:, None]).flatten(2).norm(dim=-1) / y.flatten(1).norm(dim=-1)[:, None]
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=0)


@pytest.mark.parametrize("penalty", [0.5, 0.01])
def test_candidates_are_the_estimators(
    script: ModuleType, library: tb.MaterialLibrary, bases: list[tb.BasisImages], penalty: float
) -> None:
    kept = bases[0].without("material-2")
    classes = tb.MaterialClasses.fit(library.without("material-2"), 2)
    assert classes.n_classes == 2
    image = bases[0].image("material-2").double()
    photographs = torch.stack([image, image.flip(-1) + 0.01])
    expected = tb.BRDFEstimator(kept, classes, penalty, solver="lstsq")(photographs).class_weights
    scene = script.Scene.of("", kept.packed)
    members = [classes.members(j) for j in range(2)]
    found = script.candidates(scene, scene.project(kept.pack(photographs)), members, [0.0, penalty])[1]
    torch.testing.assert_close(found.mT, expected, rtol=1e-7, atol=1e-9)


def test_penalty_zero_is_least_squares(script: ModuleType, bases: list[tb.BasisImages]) -> None:
    scene = script.Scene.of("", bases[0].packed)
    y = bases[0].pack(bases[0].image("material-1").double().flip(-1))[None]
    found = script.candidates(scene, scene.project(y), [torch.arange(12)], [0.0])[0, 0, 0]
    for channel in range(3):
        system = bases[0].packed[:12, channel].double().T
        expected = torch.linalg.lstsq(system, y[0, channel, :, None], driver="gelsd").solution[:, 0]
        torch.testing.assert_close(found[channel, :12], expected, rtol=1e-5, atol=1e-7)
    assert not found[:, 12:].any()
    assert not torch.allclose(found[:, :12], prior_mean(12, like=found).expand(3, -1), atol=1e-2)


def test_planted_combination_is_found_without_noise_only_by_least_squares(
    script: ModuleType, library: tb.MaterialLibrary, bases: list[tb.BasisImages]
) -> None:
    rows = experiment(script, library, bases, ["naive", "single-0.5", "paper"]).rows("mean")
    assert len(rows) == PROBES * (PROBES - 1) * 2 * 3
    error = {(row["method"], row["noise_percent"], row["observed"]): row for row in rows}
    for probe in ("probe 0", "probe 1"):
        exact, regularised = error["naive", "0", probe], error["single-0.5", "0", probe]
        assert float(exact["observation_error"]) < 1e-3  # float16 columns
        assert float(exact["novel_error"]) < 1e-3
        assert float(exact["log_error"]) < 1e-3
        assert float(exact["light_0_error"]) < 2e-3
        assert float(regularised["novel_error"]) > 5e-3
        noisy = error["naive", "2", probe]
        assert 0.01 < float(noisy["observation_error"]) < 0.021  # least squares fits some of the noise
        assert float(noisy["novel_error"]) > 5 * float(exact["novel_error"])
    for row in rows:
        assert float(row["best_class_error"]) <= float(row["novel_error"])
        assert (row["class"] == "") == (row["method"] != "classes-0.5")


@pytest.mark.parametrize("material", ["material-0", "material-3"])
def test_rows_are_what_the_estimator_gives(
    script: ModuleType, library: tb.MaterialLibrary, bases: list[tb.BasisImages], material: str
) -> None:
    rows = experiment(script, library, bases, ["single-0.1", "paper", "auto"]).rows(material)
    remaining = library.without(material)
    four, one = tb.MaterialClasses.fit(remaining, 2), tb.MaterialClasses.single(remaining)
    basis, other = (images.without(material) for images in bases)
    clean, novel = (images.pack(images.image(material)).double() for images in bases)
    noisy = script.noisy_observations(clean, [2], f"0 {material} probe 0")[0]
    for name, classes, penalty in (("single-0.1", one, 0.1), ("classes-0.5", four, "paper")):
        result = tb.BRDFEstimator(basis, classes, penalty)(basis.unpack(noisy))
        fitted = torch.einsum("knc,ncp->kcp", result.class_weights, other.packed.double())
        errors = (fitted - novel).flatten(1).norm(dim=1) / novel.norm()
        row = next(r for r in rows if (r["method"], r["observed"], r["noise_percent"]) == (name, "probe 0", "2"))
        assert float(row["observation_error"]) == pytest.approx(float(result.relative_error), rel=1e-4)
        assert float(row["novel_error"]) == pytest.approx(float(errors[result.class_index]), rel=1e-4)
        assert float(row["best_class_error"]) == pytest.approx(float(errors.min()), rel=1e-4)
    result = tb.BRDFEstimator(basis, four, penalty="auto")(basis.unpack(noisy))
    fitted = torch.einsum("nc,ncp->cp", result.weights, other.packed.double())
    row = next(r for r in rows if (r["method"], r["observed"], r["noise_percent"]) == ("auto", "probe 0", "2"))
    assert float(row["observation_error"]) == pytest.approx(float(result.relative_error), rel=1e-3)
    assert float(row["novel_error"]) == pytest.approx(float((fitted - novel).norm() / novel.norm()), rel=1e-4)


def test_the_left_out_material_is_not_used(
    script: ModuleType, library: tb.MaterialLibrary, bases: list[tb.BasisImages]
) -> None:
    """Its basis images may be anything."""
    whole = experiment(script, library, bases, ["naive", "single-0.5", "paper"])
    others = []
    for scene in whole.scenes:
        r = scene.r.clone()
        r[..., 6:9] *= 5
        others.append(replace(scene, r=r))
    changed = replace(whole, scenes=others)
    assert changed.rows("material-2") == whole.rows("material-2")
    assert changed.rows("material-3") != whole.rows("material-3")


def test_noise_has_the_level_and_is_reproducible(script: ModuleType) -> None:
    image = torch.rand(3, 40_000, dtype=torch.float64) + 0.1
    noisy = script.noisy_observations(image, [0, 1, 2], "0 brass grace")
    assert torch.equal(noisy[0], image)
    e = noisy / image - 1
    assert abs(float(e[1].std()) - 0.01) < 1e-4
    assert abs(float(e[1].mean())) < 2e-4
    assert abs(float(torch.corrcoef(e[1])[0, 1])) < 0.02
    torch.testing.assert_close(e[2], 2 * e[1])
    assert torch.equal(script.noisy_observations(image, [2], "0 brass grace")[0], noisy[2])
    assert not torch.equal(script.noisy_observations(image, [2], "0 steel grace")[0], noisy[2])


def test_classes_are_matched_by_their_members(script: ModuleType) -> None:
    reference = torch.tensor([0, 0, 0, 1, 1, 2, 2, 3])
    labels = torch.tensor([1, 1, 1, 0, 0, 2, 2, 2])
    assert script.match_classes(labels, reference, 4) == [1, 0, 2]


def test_directional_light_on_a_lambertian_sphere(script: ModuleType) -> None:
    albedo = torch.tensor([0.2, 0.5, 0.8], dtype=torch.float64)
    table = tb.MerlTable.from_function(lambda w_i, w_o: (albedo / torch.pi).expand_as(w_i), "lambert")
    view = tb.SphereView(16)
    normals = view.pack(view.normals).double()
    for angle, light in ((0, (0, 0, 1)), (136, (0.694658, 0, -0.719340))):
        cos_i = torch.tensor(light, dtype=torch.float64) @ normals
        _, packed = script.directional_scene(tb.MaterialLibrary.from_tables([table]), view, angle)
        expected = (albedo / torch.pi)[:, None] * cos_i[cos_i > 0]
        torch.testing.assert_close(packed[:, 1], expected, rtol=1e-3, atol=1e-6)


def test_cells_see_the_peak_and_negative_values(script: ModuleType, library: tb.MaterialLibrary) -> None:
    cells = script.CellSample.of(library, 0)
    weights = torch.zeros(2, 3, library.n, dtype=torch.float64)
    for channel in range(3):
        weights[:, channel, 3 + channel] = 1
    weights[1] *= -1
    log_error, negative = cells.compare(weights, torch.arange(3, 6))
    assert float(log_error[0]) == 0
    assert negative.tolist() == [0, 1]
    expected = torch.log1p(cells.columns[:, 3:6] * cells.cos_i[:, None]).mean()
    torch.testing.assert_close(log_error[1], expected)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, tables: list[tb.MerlTable]) -> Path:
    """A folder with the tables as files, and two probes."""
    path = tmp_path_factory.mktemp("experiment")
    (path / "merl").mkdir()
    for table in tables:
        table.save(path / "merl" / f"{table.name}.binary")
    for i in range(2):
        radiance = torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(i)) ** 8
        tb.write_image(path / f"probe{i}.exr", radiance)
    return path


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path_factory.getbasetemp() / "leave_one_out_cache"))


def arguments(folder: Path, out: Path, *more: str) -> list[str]:
    sizes = ["--size", "8", "--samples", "32", "--classes", "2", "--noise", "0", "2"]
    probes = [str(folder / "probe0.exr"), str(folder / "probe1.exr")]
    return ["--library", str(folder / "merl"), "--probes", *probes, "-o", str(out), *sizes, *more]


def test_an_interrupted_run_continues_to_the_same_results(
    script: ModuleType,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert script.main(arguments(folder, tmp_path / "whole", "--penalties", "0.05")) == 0
    reconstruct, seen = script.Experiment.rows, []

    def interrupted(self, material: str):
        if len(seen) == 3:
            raise KeyboardInterrupt
        seen.append(material)
        return reconstruct(self, material)

    monkeypatch.setattr(script.Experiment, "rows", interrupted)
    parts = arguments(folder, tmp_path / "parts", "--penalties", "0.05")
    capsys.readouterr()
    assert script.main(parts) == 130
    assert "interrupted; the same command goes on where it stopped" in capsys.readouterr().err
    assert not (tmp_path / "parts" / "results.csv").exists()
    finished = sorted(path.stem for path in (tmp_path / "parts" / "rows").iterdir())
    assert finished == seen
    seen.clear()
    monkeypatch.setattr(script.Experiment, "rows", lambda self, m: seen.append(m) or reconstruct(self, m))
    assert script.main(parts) == 0
    assert len(seen) == MATERIALS - 3
    results = [(tmp_path / run / "results.csv").read_bytes() for run in ("whole", "parts")]
    assert results[0] == results[1]

    with open(tmp_path / "whole" / "results.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == MATERIALS * PROBES * 2 * 6
    naive = [float(r["novel_error"]) for r in rows if (r["method"], r["noise_percent"]) == ("naive", "2")]
    summary = (tmp_path / "whole" / "summary.md").read_text()
    section = summary.split("### 2 % noise")[1]
    line = next(line for line in section.splitlines() if line.startswith("| naive |")).split(" | ")
    middle = torch.tensor(naive, dtype=torch.float64).quantile(0.5)
    assert line[2:4] == [f"{sum(naive) / len(naive):.3f}", f"{middle:.3f}"]
    assert line[5] == f"{max(naive):.2f}"
    picture = tb.read_image(tmp_path / "whole" / "errors.png", allow_ldr=True)
    assert picture.shape[0] in (3, 4)

    # A subset of the materials, in another order, gives the same rows.
    document = tmp_path / "page.md"
    begin, end = "<!-- results: begin (written by the command above) -->", "<!-- results: end -->"
    document.write_text(f"# Title\n\n{begin}\nold\n{end}\nlast line\n")
    few = arguments(folder, tmp_path / "few", "--penalties", "0.05", "--materials", "material-5", "material-1")
    assert script.main([*few, "--document", str(document)]) == 0
    body = (tmp_path / "few" / "summary.md").read_text().removeprefix("# Leave-one-out\n\n")
    assert document.read_text() == f"# Title\n\n{begin}\n\n{body}\n{end}\nlast line\n"
    assert (tmp_path / "figures" / "page.png").exists()
    for name in ("material-1.csv", "material-5.csv"):
        rows = [(tmp_path / run / "rows" / name).read_bytes() for run in ("whole", "few")]
        assert rows[0] == rows[1]

    shared = arguments(folder, tmp_path / "shared", "--materials", "material-1", "--shared-samples")
    assert script.main(shared) == 0
    assert "differs by 0.00 % (median), 0.00 % (95th" in (tmp_path / "shared" / "summary.md").read_text()
    assert "differs by 0.00 % (median)" not in summary

    capsys.readouterr()
    assert script.main(arguments(folder, tmp_path / "whole", "--seed", "3")) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "holds results with another methods" in error


def test_bad_input_is_one_line(
    script: ModuleType, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    probe = str(folder / "probe0.exr")
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    merl, out = str(folder / "merl"), str(tmp_path / "out")
    cases = [
        ([merl, [probe], out], "at least two probes are needed (observed and novel), got 1"),
        ([merl, [probe, probe], out], "probes must have different names; 'probe0' comes twice"),
        ([merl, [probe, "absent.exr"], out], "absent.exr: no such file"),
        ([str(tmp_path / "empty"), [probe, "default"], out], "empty"),
        ([merl, [probe, "default"], out, "--materials", "gold"], "no material 'gold' in this library of 8"),
        ([merl, [probe, "default"], out, "--methods", "best"], "method must be naive, paper, auto, single-X"),
        ([merl, [probe, "default"], out, "--penalties", "x"], "got 'single-x'"),
        ([merl, [probe, "default"], out, "--noise", "-1"], "and noise levels at least 0"),
        ([merl, [probe, "default"], out, "--size", "1"], "at least 3 x 3 pixels, got size=1"),
        ([merl, [probe, "default"], str(tmp_path / "file")], "file"),
        ([merl, [probe, "default"], out, "--document", str(tmp_path / "file")], "file: needs one line '<!-- results"),
        ([merl, [probe, "default"], out, "--document", "absent.md"], "absent.md"),
    ]
    for (library, probes, output, *more), message in cases:
        capsys.readouterr()
        assert script.main(["--library", library, "--probes", *probes, "-o", output, *more]) == 2
        error = capsys.readouterr().err.rpartition("\r")[2]  # after the bar of a library that is read first
        assert error.startswith("leave_one_out: error: ")
        assert message in error
        assert error.count("\n") == 1
    with pytest.raises(SystemExit) as raised:
        script.main(["--library", merl, "--probes", probe, "default", "-o", out, "--noise", "much"])
    assert raised.value.code == 2
    said = "leave_one_out: error: argument --noise: invalid float value: 'much'; see `leave_one_out --help`\n"
    assert capsys.readouterr().err == said
    assert not Path(out).exists()
