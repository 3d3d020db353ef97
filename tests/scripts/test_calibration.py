"""scripts/benchmarks/calibration.py and scripts/benchmarks/observability.py: their scores and left-out libraries."""

import pytest
import torch

import calibration
import observability as lights
from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.transport.basis_images import BasisImages


def case(sigma: float, actual: float, seed: int = 0, **labels):
    """A case that says sigma and errs by `actual`."""
    error = actual * torch.randn(3, 4000, generator=torch.Generator().manual_seed(seed))
    ones = torch.ones_like(error)
    names = {"material": "m", "observed": "a", "novel": "b", "noise": 0.0} | labels
    return calibration.Case(**names, error=error, plain=sigma * ones, mean=ones, radiance=ones * 2)


def test_crps_is_the_mean_distance_less_half_the_mean_difference():
    """E|X - y| - E|X - X'| / 2, by samples."""
    g = torch.Generator().manual_seed(0)
    x, again = torch.randn(2, 400_000, generator=g, dtype=torch.float64)
    for error, std in ((0.0, 1.0), (0.7, 0.5), (-2.0, 0.3)):
        sampled = (std * x - error).abs().mean() - (std * (x - again)).abs().mean() / 2
        found = calibration.crps(torch.tensor(error).double(), torch.tensor(std).double())
        assert float(found) == pytest.approx(float(sampled), rel=0.01)


def test_coverage_of_an_honest_case_is_what_it_says():
    honest = [case(0.02, 0.02, seed) for seed in range(4)]
    plain = {"std": lambda one: one.std(1.0, 0.0)}
    assert calibration.coverage(honest, calibration.Z_90, **plain) == pytest.approx(0.9, abs=0.005)
    assert calibration.coverage(honest, calibration.Z_50, **plain) == pytest.approx(0.5, abs=0.01)
    assert float(honest[0].std(2.0, 0.03)[0, 0]) == pytest.approx(0.05)


def test_scores_know_a_case_of_larger_error():
    cases = [case(sigma, sigma, i) for i, sigma in enumerate((0.01, 0.05, 0.02, 0.1))]
    row = calibration.score_row("x", cases, lambda one: one.std(1.0, 0.0))
    assert row[-1] == "1.00"
    assert float(row[1]) == pytest.approx(90, abs=0.7)
    assert float(row[4]) == pytest.approx(100 * 2 * 1.645 * 0.045, abs=0.06)
    flat = calibration.score_row("x", cases, lambda one: torch.full_like(one.error, 0.045))
    assert float(flat[6]) > float(row[6])
    assert float(flat[7]) > float(row[7])


def test_tables_group_by_label_and_brightness():
    cases = [case(0.01, 0.01, material="good"), case(0.01, 1.0, material="bad")]
    good, bad = calibration.by(cases, "material").splitlines()[2:]
    assert good.startswith("| good |")
    assert float(good.split("|")[2]) == pytest.approx(98.0, abs=0.5)  # sqrt(2) standard deviations, with UNMODELLED
    assert bad.startswith("| bad |")
    assert float(bad.split("|")[2]) < 10
    assert calibration.by_brightness(cases).splitlines()[2].startswith("| 1 to 3 x mean | 100.0 |")


def test_constants_chosen_on_one_half_are_reported_on_the_other():
    """Honest materials need no inflation, which leaves their rivals, of twice the error, uncovered; and the reverse."""
    cases = [case(0.02, (0.02, 0.04)[i % 2], i, material=f"m{i}", novel="b") for i in range(4)]
    lines = [line.strip("| ").split(" | ") for line in calibration.halves(cases).splitlines()[2:]]
    assert [line[:2] for line in lines] == [["m0, m2", "1"], ["m1, m3", "2"]]
    assert float(lines[0][3]) < 75
    assert float(lines[1][3]) > 99


def test_reliability_counts_what_was_right():
    namings = [calibration.Naming(0.7, 1.0, i < 3) for i in range(4)] + [calibration.Naming(0.95, 1.0, True)]
    lines = calibration.reliability(namings).splitlines()[2:]
    assert lines == [
        "| 0.65 to 0.8 | 4 | 0.70 | 0.75 |",
        "| 0.9 to 0.99 | 1 | 0.95 | 1.00 |",
        "| all; plain evidence says 1.00 | 5 |  | 0.80 |",
    ]


def test_left_out_classes_keep_their_labels(tiny_library):
    whole = MaterialClasses.single(tiny_library)
    whole.responsibilities = torch.nn.functional.one_hot(torch.arange(30) % 4).double()
    whole.labels = whole.responsibilities.argmax(1)
    less = tiny_library.without(tiny_library.names[0], tiny_library.names[4])
    found = calibration.whole_without(whole, less)
    kept = [*range(3, 12), *range(15, 30)]
    assert found.names == less.names
    assert torch.equal(found.labels, whole.labels[kept])
    assert torch.equal(found.norms, whole.norms[kept])


def test_likeness_is_small_between_alike_and_least_with_itself():
    packed = torch.rand(12, 3, 30, generator=torch.Generator().manual_seed(0))
    packed[9:12] = 2 * packed[3:6] * (1 + 0.01 * packed[6:9])  # the last is the second, brighter
    basis = BasisImages(packed, torch.ones(1, 5, 6, dtype=torch.bool), ("a", "b", "c", "d"), "L", "P", "V")
    order = calibration.likeness(basis).argsort(1)
    assert order[1, :2].tolist() == [1, 3]
    assert order[3, :2].tolist() == [3, 1]
    assert order[:, 0].tolist() == [0, 1, 2, 3]


def test_mixtures_have_the_brightness_of_the_second_light():
    packed = torch.rand(2, 3, 3, 6, generator=torch.Generator().manual_seed(0))
    mask = torch.ones(1, 2, 3, dtype=torch.bool)
    one, other = (BasisImages(values, mask, ("a",), "L", name, "V") for values, name in zip(packed, "pq", strict=True))
    half = lights.mixed(one, other, 0.5)
    assert float(half.packed.mean()) == pytest.approx(float(packed[1].mean()), rel=1e-6)
    assert torch.equal(lights.mixed(one, other, 0.0).packed, other.packed)
    assert torch.allclose(half.packed - other.packed / 2, one.packed * (packed[1].mean() / packed[0].mean()) / 2)
