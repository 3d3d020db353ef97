"""Tables I to III: methods against the estimator, the whole chain against itself done by hand, tables against sums."""

import csv
from collections.abc import Iterator
from importlib import import_module
from math import cos, radians, sin
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch

import torchbrdf as tb
from coarse_grids import COARSE, computed_on
from paper.rotation import results as rotation_results
from torchbrdf.lasting import LastFew
from torchbrdf.transport.harmonic import cache as harmonic_cache

NAMES = ("red", "satin-0.5", "plastic-0.1", "steel-0.15")


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return import_module("rotation_robustness")


@pytest.fixture(scope="module")
def tasks() -> ModuleType:
    return import_module("paper.rotation.tasks")


@pytest.fixture(scope="module")
def methods() -> ModuleType:
    return import_module("paper.rotation.methods")


@pytest.fixture(scope="module")
def report() -> ModuleType:
    return import_module("paper.rotation.report")


def probe(seed: int) -> tb.LightProbe:
    return tb.LightProbe(torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(seed)) ** 8)


class TestTurns:
    def test_counterclockwise_seen_from_the_tip(self, tasks: ModuleType) -> None:
        c, s = cos(radians(10)), sin(radians(10))
        for axis, expected in (
            ("X", [[1, 0, 0], [0, c, -s], [0, s, c]]),
            ("Y", [[c, 0, s], [0, 1, 0], [-s, 0, c]]),
            ("Z", [[c, -s, 0], [s, c, 0], [0, 0, 1]]),
        ):
            found = tasks.Turn(axis, 10).rotation
            torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64))
        assert tasks.Turn().rotation is None
        assert [str(turn) for turn in (tasks.Turn(), tasks.Turn("X", 5), tasks.Turn("Y", 0.5))] == ["0", "5X", "0.5Y"]

    def test_each_reconstruction_once(self, script: ModuleType) -> None:
        """Table I: 4 angles about 3 axes; II: 7 lights; III: 6 K and 9 N, one shared; the true light for all."""
        names = [run.name for run in script.runs_of([1, 2, 3], ["paper", "auto", "aligned"])]
        assert len(set(names)) == len(names)
        assert len([name for name in names if name.startswith("paper")]) == 1 + 12 + 7 + 13
        assert len([name for name in names if name.startswith("auto")]) == 1 + 12 + 7
        assert len([name for name in names if name.startswith("aligned")]) == 1 + 12
        assert {"paper-K4-N4-0-0", "auto-K4-N4-0-10Z", "paper-K4-N4-315Y-315Y", "paper-K7-N4-0-0"} <= set(names)
        assert [run.method for run in script.runs_of([3], ["auto", "paper"])] == ["paper"] * 14


@pytest.fixture(scope="module")
def lit(methods: ModuleType, tiny_library: tb.MaterialLibrary):
    return methods.Lit.of(tb.render_basis(tiny_library, probe(0), tb.SphereView(14), samples=64))


@pytest.fixture(scope="module")
def capture(methods: ModuleType, tiny_library: tb.MaterialLibrary, lit):
    """Two photographs of each of four materials, not as the basis shows them; a dull and a shiny class."""
    shiny = torch.arange(tiny_library.n) // 15
    left_out = []
    for name in NAMES:
        position, less = tiny_library.position(name), tiny_library.without(name)
        kept = torch.nonzero(torch.arange(tiny_library.n) // 3 != position).ravel()
        left_out.append(methods.LeftOut(name, position, less, kept, methods.partition(less, shiny[kept], 2)))
    clean = torch.stack([lit.basis.pack(lit.basis.image(name)).double() for name in NAMES])
    grain = 1 + 0.1 * torch.rand(len(NAMES), 2, *clean.shape[1:], generator=torch.Generator().manual_seed(1)).double()
    return methods.Capture(None, None, lit, clean[:, None] * grain, left_out)


class TestMethods:
    @pytest.mark.parametrize(("method", "penalty"), [("paper", {"penalty": "paper", "solver": "lstsq"}), ("auto", {})])
    def test_as_the_estimator_without_the_material(
        self, methods: ModuleType, capture, method: str, penalty: dict
    ) -> None:
        found = methods.METHODS[method].reconstruct(capture)
        for m, material in enumerate(capture.left_out):
            basis = capture.belief.basis
            estimator = tb.BRDFEstimator(basis.without(material.name), material.classes, **penalty)
            expected = estimator(basis.unpack(capture.photographs[m]))
            kept = [i for i in range(basis.n) if i // 3 != material.position]
            torch.testing.assert_close(found.weights[m][..., kept], expected.weights.mT, rtol=1e-6, atol=1e-8)
            torch.testing.assert_close(found.error[m], expected.error, rtol=1e-6, atol=0)
            assert found.class_index[m].tolist() == expected.class_index.tolist()
            own = [3 * material.position + c for c in range(3)]
            assert not found.weights[m][..., own].any()

    def test_both_classes_are_chosen(self, methods: ModuleType, capture) -> None:
        """Else the test above would not see a wrong choice."""
        assert set(methods.paper(capture).class_index.flatten().tolist()) == {0, 1}

    def test_classes_from_their_labels(self, methods: ModuleType, tiny_library: tb.MaterialLibrary, capture) -> None:
        """All that the estimator asks of classes is the same."""
        library = tiny_library.without("red")
        fitted = tb.MaterialClasses.fit(library, 2, 2)
        found = methods.partition(library, fitted.labels, 2)
        assert torch.equal(found.labels, fitted.labels)
        assert torch.equal(found.norms, fitted.norms)
        assert (found.names, found.library) == (library.names, library.source)
        basis = capture.belief.basis
        photograph = basis.unpack(capture.photographs[1])
        one, other = (tb.BRDFEstimator(basis.without("red"), classes)(photograph) for classes in (found, fitted))
        assert torch.equal(one.weights, other.weights)

    def test_errors_are_those_over_pixels(self, lit) -> None:
        weights = torch.randn(3, 2, 3, lit.basis.n, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        positions = [4, 0, 9]
        found = lit.errors(weights, positions)
        for m, position in enumerate(positions):
            image = lit.basis.pack(lit.basis.image(lit.basis.names[position])).double()
            shown = torch.einsum("scn,ncp->scp", weights[m], lit.basis.packed.double())
            expected = (shown - image).flatten(1).norm(dim=1) / image.norm()
            torch.testing.assert_close(found[m], expected, rtol=1e-9, atol=0)


@pytest.fixture(scope="class")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A grid of the harmonic transport that is built in a moment, an empty cache and nothing in memory."""
    with computed_on(COARSE) as patch:
        patch.setenv("TORCHBRDF_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(harmonic_cache, "_in_memory", LastFew(2))
        yield


@pytest.fixture
def files(merl_directory: Path, tmp_path: Path) -> SimpleNamespace:
    paths = []
    for seed, name in enumerate(("square", "street")):
        paths.append(str(tmp_path / f"{name}.exr"))
        probe(seed).save(paths[-1])
    return SimpleNamespace(library=str(merl_directory), probes=paths, out=tmp_path / "out")


class TestChain:
    def test_rows_are_what_they_say(
        self, script: ModuleType, small: None, files: SimpleNamespace, capsys: pytest.CaptureFixture,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:  # fmt: skip
        monkeypatch.setattr(script, "ANGLES", (3,))
        command = ["--library", files.library, "--probes", *files.probes, "-o", str(files.out), "--size", "12"]
        command += ["--tables", "1", "--materials", "red", "gold-0.3", "teal", "--every", "auto=2", "--processes", "1"]
        command += ["--methods", "paper", "auto"]
        assert script.main(command) == 0
        said = capsys.readouterr()
        with open(files.out / "results.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        # 2 probes, true light and 3 axes, 2 noise levels; 3 materials by the paper's method, 2 by the default
        assert len(rows) == 2 * 4 * 2 * (3 + 2)
        (row,) = [
            row for row in rows
            if (row["method"], row["probe"], row["believed"], row["noise_percent"], row["material"])
            == ("paper", "street", "3X", "0", "gold-0.3")
        ]  # fmt: skip
        library = tb.MaterialLibrary.from_merl(files.library)
        square, street = (tb.HarmonicBasis(library, tb.LightProbe.open(p), tb.SphereView(12)) for p in files.probes)
        angle = radians(3)
        turn = torch.tensor([[1, 0, 0], [0, cos(angle), -sin(angle)], [0, sin(angle), cos(angle)]])
        true, believed, new = street.basis_at(), street.basis_at(turn), square.basis_at()
        photograph = true.image("gold-0.3").double()
        with pytest.warns(UserWarning, match="supports 2 material classes"):
            classes = tb.MaterialClasses.fit(library.without("gold-0.3"))
        found = tb.BRDFEstimator(believed.without("gold-0.3"), classes, "paper")(photograph)
        assert float(row["error"]) == pytest.approx(float(found.error), rel=1e-4)
        assert float(row["energy"]) == pytest.approx(float(photograph.square().sum()), rel=1e-5)
        for column, basis in (("own_light_error", true), ("novel_error", new)):
            image = basis.pack(basis.image("gold-0.3")).double()
            shown = torch.einsum("nc,ncp->cp", found.weights, basis.without("gold-0.3").packed.double())
            assert float(row[column]) == pytest.approx(float((shown - image).norm() / image.norm()), rel=1e-4)
        assert (files.out / "summary.md").read_text() in said.out
        for name in ("rotation_novel.png", "rotation_likelihood.png"):
            assert (files.out / name).read_bytes().startswith(b"\x89PNG")

        before = {path: path.stat().st_mtime_ns for path in (files.out / "tasks").iterdir()}
        assert script.main(command) == 0
        assert {path: path.stat().st_mtime_ns for path in (files.out / "tasks").iterdir()} == before
        assert script.main([*command, "--noise", "0"]) == 2
        assert capsys.readouterr().err.splitlines()[-1].endswith("another noise; choose another output folder")

    def test_a_further_method_needs_an_entry_only(
        self, methods: ModuleType, tasks: ModuleType, small: None, files: SimpleNamespace,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:  # fmt: skip
        """One that knows the true light again, from what a capture holds, has no error of alignment."""

        def knowing(capture):
            assert capture.rotation is not None
            basis = capture.light.basis_at()
            truth = methods.Capture(capture.light, None, methods.Lit.of(basis), capture.photographs, capture.left_out)
            return methods.paper(truth)

        monkeypatch.setitem(methods.METHODS, "knowing", methods.Method(knowing))
        library = tb.MaterialLibrary.from_merl(files.library)
        labels = tb.MaterialClasses.fit(library.without("teal"), 1).labels
        arguments = {
            "library": library.source,
            "probes": {Path(path).stem: tb.LightProbe.open(path).fingerprint for path in files.probes},
            "observed": "square", "photographed": ["Y", 0], "n_dims": 4, "noise": [0], "size": 10, "seed": 0,
            "materials": {"teal": "".join(map(str, labels.tolist()))}, "library_path": files.library,
            "probe_paths": {Path(path).stem: path for path in files.probes},
        }  # fmt: skip
        wrong = tasks.reconstruct(**arguments, believed=["Y", 40], method="paper")
        right = tasks.reconstruct(**arguments, believed=["Y", 0], method="paper")
        found = tasks.reconstruct(**arguments, believed=["Y", 40], method="knowing")
        assert found == right != wrong

    def test_files_that_changed_are_refused(self, tasks: ModuleType, small: None, files: SimpleNamespace) -> None:
        with pytest.raises(ValueError, match=r": holds other tables than when the sweep was started$"):
            tasks.open_library(files.library, "0")
        library = tb.MaterialLibrary.from_merl(files.library)
        with pytest.raises(ValueError, match=r"square.exr: another light probe than when the sweep was started$"):
            tasks.light_under(library, files.probes[0], "0", 8)


def rows() -> list[dict[str, str]]:
    """One material a class under two probes, by the default for three of them.

    E is 2 under the true light; 3, 4 and 8 under one turned by 1 degree about X, Y and Z; 6 where the light itself is
    turned by 45 degrees, with another class for the last material. Errors under the probe as it is are a tenth of it.
    """
    made = []
    for name, method in (("grace", "paper"), ("here", "paper"), ("grace", "auto"), ("here", "auto")):
        for photographed, believed, error in (
            ("0", "0", 2), ("0", "1X", 3), ("0", "1Y", 4), ("0", "1Z", 8), ("45Y", "45Y", 6)
        ):  # fmt: skip
            for kind in range(4 if method == "paper" else 3):
                made.append({
                    "method": method, "noise_percent": "0", "probe": name, "photographed": photographed,
                    "believed": believed, "n_classes": "4", "n_dims": "4", "material": f"material-{kind}",
                    "error": str(error * (kind + 1)), "own_light_error": str(0.1 * error),
                    "novel_error": str(0.01 * error), "material_class": str(kind),
                    "class": str(0 if photographed == "45Y" and kind == 3 else kind),
                })  # fmt: skip
    return made


class TestReport:
    def cells(self, table: str, row: int) -> list[str]:
        return [cell.strip() for cell in table.splitlines()[2 + row].strip("|").split("|")]

    def test_table_1(self, report: ModuleType) -> None:
        """(3, 4, 8) / 2 - 1 = 0.5, 1, 3: mean 1.5, median 1."""
        results = rotation_results.Results(rows(), 4)
        table = report.likelihood_table(results, "0", "paper", "believed")
        assert table.splitlines()[0].split("|")[3:7] == [
            " Diffuse ", " Plastics & phenolics ", " Metals ", " Specular paints & plastics "
        ]  # fmt: skip
        paper = [" [2.11]", " [3.17]", " [2.18]", " [0.99]"]
        assert self.cells(table, 0) == ["grace", "1°", *(f"1.50 / 1.00{figure}" for figure in paper)]
        assert self.cells(table, 1) == ["here", "1°", *["1.50 / 1.00"] * 4]
        assert self.cells(report.likelihood_table(results, "0", "auto", "believed"), 0)[4] == ""  # no such material

    def test_table_1_under_the_true_light(self, report: ModuleType) -> None:
        """(9, 16, 64) / 4 - 1 = 1.25, 3, 15: mean 6.42, median 3."""
        table = report.likelihood_table(rotation_results.Results(rows(), 4), "0", "paper", "true")
        assert self.cells(table, 1) == ["here", "1°", *["6.42 / 3.00"] * 4]

    def test_novel_light_of_the_materials_that_all_have(self, report: ModuleType) -> None:
        results = rotation_results.Results(rows(), 4)
        ((methods, materials),) = rotation_results.comparisons(results)
        assert methods == ["paper", "auto"]
        assert materials == {"material-0", "material-1", "material-2"}
        table = report.novel_table(results, "0", methods, materials)
        assert self.cells(table, 0) == ["grace", "0°", "paper", "2.0", "2.0", "", "2.0", "2.0", "2.0", "2.0"]
        assert self.cells(table, 2) == ["grace", "1°", "paper", "5.0", "5.0", "", "5.0", "5.0", "4.0", "8.0"]

    def test_a_method_with_few_materials_has_a_table_of_its_own(self, report: ModuleType) -> None:
        few = [{**row, "method": "few"} for row in rows() if row["method"] == "auto" and row["material_class"] == "1"]
        assert rotation_results.comparisons(rotation_results.Results([*rows(), *few], 4)) == [
            (["paper", "auto"], {"material-0", "material-1", "material-2"}),
            (["paper", "auto", "few"], {"material-1"}),
        ]
        alone = [row for row in rows() if row["method"] == "paper"]
        found = rotation_results.comparisons(rotation_results.Results(alone, 4))
        assert found == [(["paper"], {f"material-{i}" for i in range(4)})]

    def test_table_2(self, report: ModuleType) -> None:
        """0.6^2 / 0.2^2 - 1; one of four materials changes its class; E itself 6 / 2."""
        cells = self.cells(report.stability_table(rotation_results.Results(rows(), 4), "0", "paper"), 0)
        growth = [f"8.00 / 8.00 [{paper}]" for paper in ("30.00", "4.41", "1.37", "2.57")]
        assert cells == ["45°", *growth, "25.00 % [4 %]", "3.00 / 3.00", "6.0", "2.0"]

    def test_table_3(self, report: ModuleType) -> None:
        """Classes 2, 2, 2 and 0 win: 75 and 25 per cent."""
        made = [row for row in rows() if row["method"] == "paper" and row["believed"] == "0"]
        made += [{**row, "n_classes": "3", "class": str(0 if row["material"] == "material-1" else 2)} for row in made]
        facts = rotation_results.MixtureFacts([6, 6], 2, 3, 0.99, 0.9)
        facts = rotation_results.Facts(4, 64, {(4, 4): facts, (3, 4): facts})
        table = report.class_count_table(rotation_results.Results(made, 4), facts, "0")
        expected = ["3", "2 to 3", "75.00 [46.75]", "25.00 [45.25]", "0.00 [8.00]", "", "2.0", "2.0"]
        assert self.cells(table, 0) == expected
        assert self.cells(table, 1)[2:6] == ["25.00 [48.25]", "25.00 [44.25]", "25.00 [5.50]", "25.00 [2.00]"]

    def test_what_was_not_computed_is_left_out(self, report: ModuleType) -> None:
        facts = rotation_results.Facts(4, 64, {(4, 4): rotation_results.MixtureFacts([3] * 4, 4, 4, 1, 1)})
        whole = report.summary(rotation_results.Results(rows(), 4), facts)
        assert [line for line in whole.splitlines() if line.startswith("## ")] == [
            "## Table I: relative log-likelihood error under the light as it was believed",
            "## Table I: relative log-likelihood error under the true light",
            "## Table I: novel-light error in per cent, 0 % noise, 3 materials",
            "## Table II: relative log-likelihood error under the light at 0°",
        ]
        some = [row for row in rows() if row["photographed"] == "0" and row["method"] == "auto"]
        part = report.summary(rotation_results.Results(some, 4), facts)
        assert "Table II:" not in part
        assert "`auto`, 3 materials, 0 % noise:" in part

    def test_classes_without_the_names_of_the_paper(self, report: ModuleType) -> None:
        found = rotation_results.class_columns(rotation_results.Results(rows(), 3))
        assert found == ([0, 1, 2, 3], [f"class {j}" for j in range(4)])


class TestClasses:
    def test_agreement(self, script: ModuleType) -> None:
        """0 stands for 1, 1 for 0; one column of six differs."""
        assert script.agreement("001112", "110022", 3) == ([1, 0, 2], pytest.approx(5 / 6))

    def test_facts_of_the_fits(self, script: ModuleType, tiny_library: tb.MaterialLibrary) -> None:
        whole, usual = "000111" * 5, "000000111111" * 2 + "000000"
        one, other = (script.without(labels, tiny_library, "red") for labels in (usual, whole))
        labels = {
            (4, 4): {None: usual, "red": one},
            (2, 4): {None: whole, "red": other.translate({48: "1", 49: "0"})},
        }
        facts, meanings = script.mixture_facts(labels, tiny_library)
        assert facts[2, 4].sizes == [15, 15]
        assert (facts[2, 4].fewest, facts[2, 4].most, facts[2, 4].steady) == (2, 2, 1)
        assert facts[2, 4].as_usual == pytest.approx(np.mean([a == b for a, b in zip(whole, usual, strict=True)]))
        assert meanings[2, 4] == {"red": [1, 0]}


class TestBadInput:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--every", "best=2"], "expected METHOD=N with METHOD of paper, auto, aligned and N >= 1, got 'best=2'"),
            (["--every", "auto=0"], "expected METHOD=N with METHOD of paper, auto, aligned and N >= 1, got 'auto=0'"),
            (["--tables", "4"], "invalid choice: 4"),
        ],
    )
    def test_options(
        self, script: ModuleType, arguments: list[str], message: str, capsys: pytest.CaptureFixture
    ) -> None:
        with pytest.raises(SystemExit) as left:
            script.main(["--library", "default", "--probes", "default", "-o", "out", *arguments])
        assert left.value.code == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("rotation_robustness: error: ")
        assert message in line

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--noise", "-1"], "noise levels must be at least 0, got [-1.0]"),
            ([], "at least two probes are needed (observed and novel), got 1"),
            (["--document", "nowhere.md"], "nowhere.md: No such file or directory"),
        ],
    )
    def test_settings(
        self, script: ModuleType, arguments: list[str], message: str, capsys: pytest.CaptureFixture
    ) -> None:
        assert script.main(["--library", "nowhere", "--probes", "default", "-o", "out", *arguments]) == 2
        assert capsys.readouterr().err == f"rotation_robustness: error: {message}\n"
