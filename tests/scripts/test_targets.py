"""Targets (scripts/make_targets.py) and what is measured on them (scripts/benchmarks/accuracy.py)."""

import hashlib
import itertools
import json
import shutil
import statistics
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

import accuracy as benchmark
import make_targets
import torchbrdf as tb
from torchbrdf.experiments import accuracy, accuracy_cases, open_probes, targets as targets_module
from torchbrdf.images import read_metadata, write_image
from torchbrdf.mitsuba_backend.scenes import HalfRenderings, MitsubaScene
from torchbrdf.mitsuba_startup.loading import MitsubaUnavailableError, load_mitsuba
from turns import degrees_between

SIZE = 10



@pytest.fixture(scope="module")
def mitsuba() -> ModuleType:
    try:
        return load_mitsuba()
    except MitsubaUnavailableError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def probes() -> dict[str, tb.LightProbe]:
    room = tb.LightProbe.default(16)
    half_turn = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    noise = torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(5)) ** 4
    return {"room": room, "back": room.rotated(half_turn), "noise": tb.LightProbe(noise)}


@pytest.fixture(scope="module")
def probe_files(probes: dict[str, tb.LightProbe], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("probes")
    for name, probe in probes.items():
        write_image(folder / f"{name}.exr", probe.radiance)
    return [folder / f"{name}.exr" for name in probes]


# Monte Carlo noise


@dataclass
class FakeScene:
    """Renders constant images whose halves differ so that the noise is `level` at 100 samples, and falls as 1/sqrt."""

    level: float
    calls: list[tuple[int, int]] = field(default_factory=list)
    total: float = 0

    def render_halves(self, samples: int, seed: int) -> HalfRenderings:
        self.calls.append((samples, seed))
        value = float(len(self.calls))
        self.total += samples * value
        done = sum(count for count, _ in self.calls)
        mean = self.total / done
        # The halves of all samples so far shall be mean (1 +- s); those of these samples follow from it.
        wanted = mean * self.level * (100 / done) ** 0.5
        ours = (wanted * done - getattr(self, "spread", 0.0)) / samples
        self.spread = wanted * done
        return HalfRenderings(torch.full((3, 2, 2), value + ours), torch.full((3, 2, 2), value - ours))


def test_samples_are_added_until_the_noise_is_small_enough() -> None:
    scene = FakeScene(level=0.05)
    quality = make_targets.Quality(samples=100, noise=0.01, max_samples=100_000)
    halves, samples = make_targets.render_halves(scene, quality, seed=7)
    counts, seeds = zip(*scene.calls, strict=True)
    assert samples == sum(counts)
    assert list(np.cumsum(counts)) == [100, 400, 1600, 2750]  # 4-fold, 4-fold, then 1.1 times what is needed
    assert all(count % 2 == 0 for count in counts)
    assert seeds == (7, 8, 9, 10)
    expected = sum(count * (k + 1) for k, count in enumerate(counts)) / samples
    assert float(halves.image.mean()) == pytest.approx(expected, rel=1e-5)
    assert halves.noise == pytest.approx(0.05 * (100 / samples) ** 0.5, rel=1e-3)
    assert halves.noise <= quality.noise


@pytest.mark.parametrize(("cap", "spent"), [(1000, 1000), (1001, 1000), (101, 100)])
def test_samples_are_capped(cap: int, spent: int) -> None:
    scene = FakeScene(level=0.05)
    quality = make_targets.Quality(samples=100, noise=0.01, max_samples=cap)
    halves, samples = make_targets.render_halves(scene, quality, seed=0)
    assert samples == spent == sum(count for count, _ in scene.calls)
    assert halves.noise > quality.noise


def test_two_seeds_differ_as_the_noise_says(mitsuba: ModuleType, probes: dict[str, tb.LightProbe]) -> None:
    for name in ("white-plaster", "copper-blasted"):
        scene = MitsubaScene(tb.SphereView(16), probes["noise"], make_targets.ANALYTIC[name])
        quality = make_targets.Quality(16, 256, 1.0, 256)
        runs = [make_targets.render_halves(scene, quality, 10 * k)[0] for k in range(6)]
        images = torch.stack([run.image for run in runs]).double()
        spread = torch.linalg.vector_norm(images - images.mean(0)) / (5**0.5 * images.mean(0).norm())
        stated = statistics.mean(run.noise for run in runs)
        assert float(spread) == pytest.approx(stated, rel=0.12), name


@pytest.mark.parametrize(("samples", "noise", "cap"), [(1, 0.01, 10), (20, 0.01, 10)])
def test_bad_samples(samples: int, noise: float, cap: int) -> None:
    message = f"^samples must be at least 2 and at most max_samples, got {samples} and {cap}$"
    with pytest.raises(ValueError, match=message):
        make_targets.Quality(64, samples, noise, cap)


# Files


def run_make(folder: Path, probe_files: list[Path], *options: str) -> int:
    fast = ["--size", str(SIZE), "--samples", "32", "--noise", "0.5", "--max-samples", "32"]
    paths = [str(path) for path in probe_files]
    chosen = ["--analytic", "--materials", "white-plaster", "copper-blasted", "blue-billiard"]
    return make_targets.main([*chosen, "--probes", *paths, "-o", str(folder), *fast, *options])


@pytest.fixture(scope="module")
def analytic(mitsuba: ModuleType, probe_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("analytic")
    assert run_make(folder, probe_files, "--samples", "1024", "--max-samples", "1024") == 0
    return folder


def test_every_analytic_material_can_be_rendered(mitsuba: ModuleType, tmp_path: Path, probe_files: list[Path]) -> None:
    command = ["--analytic", "--probes", str(probe_files[0]), "-o", str(tmp_path), "--size", "4", "--samples", "2"]
    assert make_targets.main([*command, "--max-samples", "2"]) == 0
    found = targets_module.read_targets(tmp_path)
    assert sorted(target.material for target in found) == sorted(make_targets.ANALYTIC)


def test_metadata_say_what_a_target_is(analytic: Path, probes: dict[str, tb.LightProbe]) -> None:
    path = analytic / "back" / "copper-blasted.exr"
    target = targets_module.Target.open(path)
    assert (target.material, target.probe, target.size) == ("copper-blasted", "back", SIZE)
    opened = tb.LightProbe(probes["back"].radiance).fingerprint
    assert target.probe_fingerprint == opened
    found = target.metadata
    assert json.loads(found["bsdf"]) == make_targets.ANALYTIC["copper-blasted"]
    assert found["plugin"] == "roughconductor"
    assert (found["samples"], found["seed"], found["asked_noise"]) == ("1024", "0", "0.5")
    assert found["renderer"].startswith("mitsuba 3")
    assert json.loads(found["integrator"]) == {"type": "direct"}
    assert 0 < target.noise < 0.1
    assert (target.image[:, ~tb.SphereView(SIZE).mask[0]] == 0).all()


def watch_targets(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The targets of a folder that are made from now on, as they are made."""
    made: list[Path] = []
    original = make_targets.make_target

    def counted(path: Path, *others: object) -> None:
        made.append(path.relative_to(folder))
        original(path, *others)

    monkeypatch.setattr(make_targets, "make_target", counted)
    return made


def test_resumption_skips_what_is_there(
    analytic: Path, probe_files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "targets"
    shutil.copytree(analytic, folder)
    made = watch_targets(folder, monkeypatch)
    same = ["--samples", "1024", "--max-samples", "1024"]
    assert run_make(folder, probe_files, *same) == 0
    assert made == []

    lost, damaged = Path("room/white-plaster.exr"), Path("noise/blue-billiard.exr")
    (folder / lost).unlink()
    (folder / damaged).write_bytes(b"hello")
    before = targets_module.Target.open(analytic / lost)
    assert run_make(folder, probe_files, *same) == 0
    assert made == [lost, damaged]
    assert torch.equal(targets_module.Target.open(folder / lost).image, before.image)

    made.clear()
    assert run_make(folder, probe_files, *same, "--seed", "1") == 0
    assert len(made) == 9
    assert not torch.equal(targets_module.Target.open(folder / lost).image, before.image)


# Turned probes

TURNED = ["--turned", "40", "--samples", "1024", "--max-samples", "1024"]


def rotation_of(target) -> torch.Tensor:
    """What the metadata say, checked to be a rotation."""
    rotation = torch.tensor(json.loads(target.metadata["rotation"]), dtype=torch.float64)
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3, dtype=torch.float64))
    assert torch.linalg.det(rotation) > 0
    return rotation


@pytest.fixture(scope="module")
def turned(mitsuba: ModuleType, probe_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("turned")
    assert run_make(folder, probe_files, *TURNED) == 0
    return folder


def test_probes_are_turned_by_no_more_than_asked(turned: Path) -> None:
    """Each by another angle, about another axis."""
    rotations = [rotation_of(target) for target in targets_module.read_targets(turned)]
    angles = torch.tensor([degrees_between(rotation, torch.eye(3)) for rotation in rotations])
    assert len(angles) == 9
    assert 0 < float(angles.min()) < 20 < float(angles.max()) <= 40
    assert len({round(float(angle), 6) for angle in angles}) == 9
    axes = torch.stack([rotation - rotation.T for rotation in rotations])[:, [2, 0, 1], [1, 2, 0]]
    axes = torch.nn.functional.normalize(axes, dim=1)
    assert float((axes @ axes.T - 2 * torch.eye(9)).max()) < 0.999
    assert bool((axes > 0).any(0).all())
    assert bool((axes < 0).any(0).all())


def test_a_turned_target_shows_its_rotation(
    turned: Path, analytic: Path, probes: dict[str, tb.LightProbe], mitsuba: ModuleType
) -> None:
    """The fingerprint is that of the probe as it is; the picture is that under the turned one."""
    path = Path("noise/copper-blasted.exr")
    target, straight = (targets_module.Target.open(folder / path) for folder in (turned, analytic))
    assert target.probe_fingerprint == straight.probe_fingerprint
    assert "rotation" not in straight.metadata
    bsdf = make_targets.ANALYTIC["copper-blasted"]
    scene = MitsubaScene(tb.SphereView(SIZE), probes["noise"], bsdf, rotation=rotation_of(target))
    expected = scene.render(16384, seed=3)
    error = float((target.image - expected).norm() / expected.norm())
    assert error < 1.5 * target.noise
    assert float((straight.image - expected).norm() / expected.norm()) > 2 * error


def test_turned_targets_are_resumed(
    turned: Path, probe_files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same rotations again; other ones are made where another angle, another seed or no turn is asked for."""
    folder = tmp_path / "targets"
    shutil.copytree(turned, folder)
    made = watch_targets(folder, monkeypatch)
    lost = Path("room/white-plaster.exr")
    before = targets_module.Target.open(folder / lost)
    (folder / lost).unlink()
    assert run_make(folder, probe_files, *TURNED) == 0
    assert made == [lost]
    again = targets_module.Target.open(folder / lost)
    assert torch.equal(again.image, before.image)
    assert torch.equal(rotation_of(again), rotation_of(before))

    for options in (["--turned", "5"], ["--turned", "5", "--seed", "1"]):
        made.clear()
        assert run_make(folder, probe_files[:1], *TURNED, *options) == 0
        assert len(made) == 3
    assert not torch.equal(rotation_of(targets_module.Target.open(folder / lost)), rotation_of(before))


def test_targets_that_are_not_turned_are_not_those_turned_before(
    turned: Path, probe_files: list[Path], tmp_path: Path
) -> None:
    folder = tmp_path / "targets"
    shutil.copytree(turned, folder)
    assert run_make(folder, probe_files[:1], *TURNED[2:]) == 0
    for path in (folder / "room").iterdir():
        assert "rotation" not in targets_module.Target.open(path).metadata


@pytest.mark.parametrize("angle", ["-1", "181", "nan"])
def test_bad_turns(probe_files: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], angle: str) -> None:
    assert run_make(tmp_path, probe_files, "--turned", angle) == 2
    message = f"make_targets: error: probes can be turned by 0 to 180 degrees, got {float(angle)}\n"
    assert capsys.readouterr().err == message


# Interruptions and files that are none


def test_an_interrupted_run_leaves_whole_files_only(
    mitsuba: ModuleType, probe_files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    original, calls = MitsubaScene.render_halves, itertools.count()

    def interrupted(scene: MitsubaScene, *arguments: int) -> HalfRenderings:
        if next(calls) == 2:
            raise KeyboardInterrupt
        return original(scene, *arguments)

    monkeypatch.setattr(MitsubaScene, "render_halves", interrupted)
    assert run_make(tmp_path, probe_files) == 130
    assert "interrupted; the same command goes on where it stopped" in capsys.readouterr().err
    files = [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(files) == ["room/copper-blasted.exr", "room/white-plaster.exr"]
    assert run_make(tmp_path, probe_files) == 0
    assert len(targets_module.read_targets(tmp_path)) == 9


def test_measured_materials_and_a_file_that_is_none(
    mitsuba: ModuleType, shared_data: Path, probe_files: list[Path], tmp_path: Path, capsys
) -> None:
    folder = tmp_path / "rgl"
    folder.mkdir()
    (folder / "cg_sunflower_rgb.bsdf").symlink_to(shared_data / "rgl" / "cg_sunflower_rgb.bsdf")
    (folder / "broken.bsdf").write_bytes(b"hello")
    command = ["--measured", str(folder), "--probes", str(probe_files[0]), "-o", str(tmp_path / "targets")]
    small = ["--size", str(SIZE), "--samples", "64", "--max-samples", "64", "--sheet", str(tmp_path / "sheet.png")]
    assert make_targets.main([*command, *small]) == 2
    assert "make_targets: error: broken: Mitsuba cannot make this BSDF: " in capsys.readouterr().err
    (target,) = targets_module.read_targets(tmp_path / "targets")
    assert target.metadata["plugin"] == "measured"
    content = (folder / "cg_sunflower_rgb.bsdf").read_bytes()
    identity = {"type": "measured", "sha256": hashlib.sha256(content).hexdigest()}
    assert json.loads(target.metadata["bsdf"]) == identity
    assert target.image.min() < 0  # a yellow outside the gamut
    assert target.photograph.min() == 0
    assert 0.001 < target.negative == pytest.approx(float(target.metadata["negative"]), abs=1e-6)
    assert (tmp_path / "sheet.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("value", "what"), [(float("nan"), "1 pixels that are NaN"), (0.0, "no pixel that is not")])
def test_unsound_images_are_no_targets(
    mitsuba: ModuleType, probe_files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, value, what
) -> None:
    def broken(scene: MitsubaScene, samples: int, seed: int) -> HalfRenderings:
        image = torch.ones(3, SIZE, SIZE) if value else torch.zeros(3, SIZE, SIZE)
        image[:, 5, 5] = value
        return HalfRenderings(image, image)

    monkeypatch.setattr(MitsubaScene, "render_halves", broken)
    assert run_make(tmp_path, probe_files[:1]) == 2
    assert f"white-plaster under room: the image has {what}" in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.exr"))


def test_folders_that_hold_no_targets(tmp_path: Path, capsys) -> None:
    with pytest.raises(FileNotFoundError, match=r"no PROBE/MATERIAL\.exr here; make targets with scripts/make_targets"):
        targets_module.read_targets(tmp_path)
    (tmp_path / "room").mkdir()
    write_image(tmp_path / "room" / "a.exr", torch.ones(3, 4, 4))
    with pytest.raises(ValueError, match=r"room/a\.exr: not a target \('torchbrdf target 1'\)"):
        targets_module.read_targets(tmp_path)
    with pytest.raises(ValueError, match=r"another probe is called room, too; rename one of the files$"):
        open_probes([make_probe(tmp_path / "room.exr"), make_probe(tmp_path / "room" / "room.exr")])
    assert make_targets.main(["-o", str(tmp_path)]) == 2
    assert "no materials; give --measured FOLDER, --analytic or both" in capsys.readouterr().err
    assert make_targets.main(["-o", str(tmp_path), "--measured", str(tmp_path)]) == 2
    assert "no .bsdf files here" in capsys.readouterr().err


def make_probe(path: Path) -> Path:
    write_image(path, torch.ones(3, 4, 8))
    return path


# The protocol


@pytest.fixture(scope="module")
def planted(tiny_library: tb.MaterialLibrary, probes: dict[str, tb.LightProbe]) -> list:
    """Targets that are Y w of known weights plus an error, one of them with negative pixels."""
    view, generator = tb.SphereView(SIZE), torch.Generator().manual_seed(3)
    weights = 0.2 * torch.rand(2, tiny_library.n, 3, generator=generator)
    found = []
    for name, probe in probes.items():
        basis = tb.render_basis(tiny_library, probe, view, samples=64)
        for i in range(2):
            packed = torch.einsum("nc,ncp->cp", weights[i], basis.packed)
            packed = packed * (1 + 0.05 * torch.randn(packed.shape, generator=generator))
            if i == 1:
                packed[2] -= 0.3 * packed[2].mean()
            image = view.unpack(packed)
            found.append(targets_module.Target(f"material-{i}", name, probe.fingerprint, image, 0.01 * (i + 1), {}))
    return found


@pytest.fixture(scope="module")
def experiment(tiny_library: tb.MaterialLibrary, probes: dict[str, tb.LightProbe], planted):
    return accuracy.Experiment.of(tiny_library, probes, planted)


def plain_error(rendered: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float:
    """|rendered - target| / |target|, with negative targets at 0, a pixel at a time."""
    above = below = 0.0
    for row, column in zip(*np.nonzero(mask), strict=True):
        for channel in range(3):
            truth = max(0.0, float(target[channel, row, column]))
            above += (float(rendered[channel, row, column]) - truth) ** 2
            below += truth**2
    return (above / below) ** 0.5


def test_errors_are_what_a_plain_loop_gives(experiment, planted, tiny_library: tb.MaterialLibrary) -> None:
    settings = [accuracy.BASELINES[0], accuracy.Setting("two", {"n_classes": 2, "n_dims": 2, "penalty": 0.1})]
    cases = list(experiment.cases(settings, [0, 3]))
    assert len(cases) == 2 * 2 * 2 * 3 * 2  # settings, levels, materials, observed probes, novel probes
    assert len({(c.setting, c.noise, c.material, c.observed, c.novel) for c in cases}) == len(cases)
    images = {(target.material, target.probe): target.image for target in planted}
    mask = tb.SphereView(SIZE).mask[0].numpy()
    checked = 0
    for case in cases:
        assert case.novel != case.observed
        if case.noise != 0:
            continue
        n_classes, penalty = (1, 0.0) if case.setting == "naive" else (2, 0.1)
        classes = tb.MaterialClasses.fit(tiny_library, n_classes, 2 if n_classes == 2 else 4)
        estimator = tb.BRDFEstimator(experiment.bases[case.observed], classes, penalty)
        observation = images[case.material, case.observed].clamp_min(0).double()
        result = estimator(observation)
        basis = experiment.bases[case.novel]
        rendered = np.zeros((3, SIZE, SIZE))
        for channel in range(3):
            y = np.asarray(basis.packed[:, channel], dtype=float)
            rendered[channel][mask] = np.asarray(result.weights[:, channel], dtype=float) @ y
        expected = plain_error(rendered, images[case.material, case.novel].numpy(), mask)
        assert case.novel_error == pytest.approx(expected, rel=1e-4)
        fitted = plain_error(result.image.numpy(), observation.numpy(), mask)
        assert case.observation_error == pytest.approx(fitted, rel=1e-4)
        assert case.own_noise == (0.01 if case.material == "material-0" else 0.02)
        checked += 1
    assert checked == len(cases) / 2


def test_noise_is_put_on_the_observation_only(experiment) -> None:
    clean, noisy = experiment.observations("room", [0, 3])
    mask = tb.SphereView(SIZE).mask[0]
    for i, material in enumerate(experiment.materials):
        target = experiment.targets["room"][material]
        assert torch.equal(clean[i].float(), target.photograph)
        lit = mask & (target.photograph > 0).all(0)
        assert float((noisy[i] / clean[i] - 1)[:, lit].std()) == pytest.approx(0.03, rel=0.15)


def test_naive_recovers_exact_targets_and_the_floor_bounds_all(
    tiny_library: tb.MaterialLibrary, probes: dict[str, tb.LightProbe], experiment
) -> None:
    exact = []
    for name, basis in experiment.bases.items():
        image = basis.image("gold-0.3")
        exact.append(targets_module.Target("gold", name, probes[name].fingerprint, image, 0.0, {}))
    planted = replace(experiment, targets={target.probe: {"gold": target} for target in exact})
    assert all(case.novel_error < 1e-3 for case in planted.cases(accuracy.BASELINES[:1], [0]))
    assert all(case.novel_error < 1e-5 for case in planted.floor())


def test_the_floor_is_least_squares_on_all_probes(experiment) -> None:
    cases = experiment.floor()
    assert [case.setting for case in cases] == ["floor"] * 6
    for material in experiment.materials:
        squared = 0.0
        for channel in range(3):
            rows, sides = [], []
            for name, basis in experiment.bases.items():
                target = experiment.view.pack(experiment.targets[name][material].photograph).double().numpy()
                rows.append(basis.packed[:, channel].double().numpy().T / np.linalg.norm(target))
                sides.append(target[channel] / np.linalg.norm(target))
            a, b = np.concatenate(rows), np.concatenate(sides)
            squared += float(np.square(a @ np.linalg.lstsq(a, b, rcond=None)[0] - b).sum())
        found = sum(case.novel_error**2 for case in cases if case.material == material)
        assert found == pytest.approx(squared, rel=1e-4)


def test_whole_tables_are_those_that_a_user_saves(experiment, probes: dict[str, tb.LightProbe]) -> None:
    setting = accuracy.BASELINES[0]
    whole = replace(experiment, tables=True)
    case = next(iter(whole.cases([setting], [0], ["room"])))
    estimator = tb.BRDFEstimator(experiment.bases["room"], tb.MaterialClasses.single(experiment.library), 0.0)
    target = experiment.targets["room"][case.material].photograph
    table = estimator(target.double()).brdf(experiment.library)
    rendered = tb.render(table, probes[case.novel], experiment.view, seed=3000)
    expected = plain_error(
        rendered.numpy(), experiment.targets[case.novel][case.material].image.numpy(), experiment.view.mask[0].numpy()
    )
    assert case.novel_error == pytest.approx(expected, rel=0.01)
    linear = next(iter(experiment.cases([setting], [0], ["room"])))
    assert abs(linear.novel_error - expected) > 0.02 * expected


def test_targets_without_their_probe_or_material(
    tiny_library: tb.MaterialLibrary, probes: dict[str, tb.LightProbe], planted
) -> None:
    few = {name: probes[name] for name in ("room", "noise")}
    with pytest.raises(ValueError, match=r"^there are targets under back, none of the probes; add it to --probes$"):
        accuracy.Experiment.of(tiny_library, few, planted)
    with pytest.raises(ValueError, match=r"^no target of material-1 under noise; make it with scripts/make_targets"):
        accuracy.Experiment.of(tiny_library, probes, planted[:-1])
    with pytest.raises(ValueError, match=r"^new light needs targets under at least two probes, got room$"):
        accuracy.Experiment.of(tiny_library, probes, planted[:2])


def test_settings() -> None:
    assert accuracy.settings_of({}) == []
    key, values = accuracy.parse_choice("solver=lstsq,factored")
    found = accuracy.settings_of({"n_classes": [1, 2], "penalty": ["paper"], key: values})
    assert [setting.name for setting in found] == [
        "n_classes=1 penalty=paper solver=lstsq",
        "n_classes=1 penalty=paper solver=factored",
        "n_classes=2 penalty=paper solver=lstsq",
        "n_classes=2 penalty=paper solver=factored",
    ]
    assert found[2].classes == {"n_classes": 2}
    assert found[2].estimator == {"penalty": "paper", "solver": "lstsq"}
    assert accuracy.parse_choice("seed=3") == ("seed", [3])
    with pytest.raises(ValueError, match=r"^no setting 'lambda'; MaterialClasses\.fit and BRDFEstimator take"):
        accuracy.settings_of({"lambda": [1]})
    with pytest.raises(ValueError, match=r"^a setting must be KEY=VALUE or KEY=VALUE,VALUE, got 'penalty'$"):
        accuracy.parse_choice("penalty")


def test_tables_of_known_errors() -> None:
    def case(setting: str, observed: str, observation: float, novel: float) -> object:
        return accuracy_cases.Case(setting, 0, "brass", observed, "sun", observation, novel, 0.03)

    names = ["a", "b", "c", "d", "e"]
    naive = [case("naive", name, 0.01, error) for name, error in zip(names, (0.05, 0.3, 0.1, 0.2, 0.4), strict=True)]
    other = [case("mine", name, 0.02, error) for name, error in zip(names, (0.06, 0.2, 0.1, 0.1, 0.02), strict=True)]
    table = accuracy_cases.summary_table([*naive, *other])
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    assert lines[0][:6] == ["method", "observation", "novel: mean", "median", "90 %", "worst"]
    assert lines[2] == ["naive", "1.00", "21.00", "20.00", "36.00", "40.00", "20.61", "", "brass, e → sun"]
    assert lines[3][:6] == ["mine", "2.00", "9.60", "10.00", "16.00", "20.00"]
    assert lines[3][7:] == ["60 %", "brass, b → sun"]
    # sqrt(e^2 - 0.03^2), and 0 for the error that is below the noise
    expected = statistics.mean([0.0519615, 0.1977372, 0.0953939, 0.0953939, 0.0])
    assert float(lines[3][6]) == pytest.approx(100 * expected, abs=0.006)
    rows = accuracy_cases.breakdown_table([*naive, *other], "observed").splitlines()
    assert rows[0] == "| observed | naive | mine |"
    assert rows[3] == "| b | 1.00 / 30.00 | 2.00 / 20.00 |"
    assert accuracy_cases.breakdown_table([*naive[:1], *other[1:2]], "observed").splitlines()[2:] == [
        "| a | 1.00 / 5.00 |  |",
        "| b |  | 2.00 / 20.00 |",
    ]


def test_both_scripts_together(
    analytic: Path, probe_files: list[Path], merl_directory: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """White plaster is nearly in the library: predicted well, unless probes were mixed up between the two renderers."""
    rows, picture = tmp_path / "cases.csv", tmp_path / "figure.png"
    paths = [str(path) for path in probe_files]
    command = ["--targets", str(analytic), "--library", str(merl_directory), "--probes", *paths, "--noise", "0", "1"]
    command += ["--penalty", "0.05", "paper", "--n-classes", "1", "--csv", str(rows)]
    command += ["--figure", str(picture), "room", "noise"]
    assert benchmark.main(command) == 0
    out = capsys.readouterr().out
    assert "3 materials, 3 probes, 10 x 10 pixels, library of 8" in out
    for name in ("naive", "one class 0.5", "one class 0.005", "paper", "default", "floor", "n_classes=1 penalty=paper"):
        assert f"\n| {name}" in out, name
    assert out.count("| white-plaster |") == 2
    assert picture.read_bytes().startswith(b"\x89PNG")
    _, *lines = rows.read_text().splitlines()
    cases = [line.split(",") for line in lines]
    plaster = [cells for cells in cases if cells[:3] == ["one class 0.005", "0.0", "white-plaster"]]
    assert len(plaster) == 6
    assert max(float(cells[6]) for cells in plaster) < 0.08
    assert benchmark.main([*command, "--figure", str(picture), "room", "sun"]) == 2
    assert "error: --figure: there are targets under room, back, noise, not under sun" in capsys.readouterr().err
    assert benchmark.main(["--targets", str(tmp_path / "nowhere")]) == 2
    assert "nowhere: no such folder of targets; make it with scripts/make_targets.py" in capsys.readouterr().err


def test_merl_tables_as_targets(tmp_path: Path, probes: dict[str, tb.LightProbe], tiny_tables) -> None:
    tiny_tables["red"].save(tmp_path / "red.binary")
    found = benchmark.merl_targets(tmp_path, {"room": probes["room"]}, SIZE)
    expected = tb.render(tiny_tables["red"], probes["room"], tb.SphereView(SIZE), samples=1 << 15, seed=99)
    (red,) = found
    assert (red.material, red.probe, red.noise) == ("red", "room", 0)
    torch.testing.assert_close(red.image, expected, rtol=0.02, atol=1e-3)
    assert red.probe_fingerprint == probes["room"].fingerprint


def test_metadata_hold_no_machine_path(analytic: Path) -> None:
    for path in analytic.rglob("*.exr"):
        assert str(analytic.parent) not in "".join(read_metadata(path).values())
