import itertools
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_directory import MERL_MATERIALS
from torchbrdf.estimation.classes import (
    MaterialClasses,
    expectation,
    expectation_maximisation,
    k_means,
    maximisation,
    subspace_coordinates,
)


def clusters(sizes: tuple[int, ...] = (60, 40, 30, 20), dims: int = 4, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Points of Gaussians of different shape and scale, and which Gaussian each comes from."""
    g = torch.Generator().manual_seed(seed)
    points = []
    for j, size in enumerate(sizes):
        shape = torch.randn(dims, dims, generator=g, dtype=torch.float64) * 10 ** (-0.3 * j)
        centre = 4 * torch.randn(dims, generator=g, dtype=torch.float64)
        points.append(torch.randn(size, dims, generator=g, dtype=torch.float64) @ shape + centre)
    return torch.cat(points), torch.repeat_interleave(torch.tensor(sizes))


def start(n: int, k: int, seed: int = 1) -> Tensor:
    """A partition with every class present."""
    return torch.randperm(n, generator=torch.Generator().manual_seed(seed)) % k


def scaled_copies(table: MerlTable, factors: list[float]) -> list[MerlTable]:
    return [MerlTable(table.values * f, table.valid, f"m{i}") for i, f in enumerate(factors)]


def fit_with_warning(library: MaterialLibrary, message: str) -> MaterialClasses:
    with pytest.warns(UserWarning, match=message) as caught:
        classes = MaterialClasses.fit(library)
    assert len(caught) == 1
    return classes


def assert_sound(classes: MaterialClasses) -> None:
    for name, buffer in classes.named_buffers():
        assert torch.isfinite(buffer).all(), name
    assert sum(classes.sizes) == len(classes.labels)
    assert min(classes.sizes) > 0
    total = classes.responsibilities.sum(1)
    assert torch.allclose(total, torch.ones_like(total), atol=1e-12)
    assert torch.equal(classes.labels, classes.responsibilities.argmax(1))


class TestMixture:
    def test_responsibilities_by_hand(self):
        """Two unit Gaussians in one dimension, mixed 3 : 1: gamma = 1 / (1 + exp(...)/3), eq. 13."""
        x = torch.tensor([[-1.0], [0.0], [0.5], [3.0]]).double()
        mixing, means = torch.tensor([0.75, 0.25]).double(), torch.tensor([[0.0], [2.0]]).double()
        gamma, log_likelihood = expectation(x, mixing, means, torch.ones(2, 1, 1).double())
        for i, point in enumerate(x[:, 0].tolist()):
            a = 0.75 * np.exp(-0.5 * point**2) / np.sqrt(2 * np.pi)
            b = 0.25 * np.exp(-0.5 * (point - 2) ** 2) / np.sqrt(2 * np.pi)
            assert gamma[i].tolist() == pytest.approx([a / (a + b), b / (a + b)], rel=1e-12)
            assert float(log_likelihood[i]) == pytest.approx(np.log(a + b), rel=1e-12)

    def test_far_points_do_not_underflow(self):
        x = torch.tensor([[1e3], [-1e3]]).double()
        means = torch.tensor([[0.0], [2.0]]).double()
        gamma, log_likelihood = expectation(x, torch.tensor([0.5, 0.5]).double(), means, torch.ones(2, 1, 1).double())
        assert torch.isfinite(log_likelihood).all()
        assert gamma.sum(1).tolist() == pytest.approx([1, 1])

    def test_means_and_covariances_divide_by_n_pi(self):
        """Eqs. 14-16, the last two with the n that print left out, written with loops."""
        x, _ = clusters((12, 8))
        gamma = torch.rand(20, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
        gamma /= gamma.sum(1, keepdim=True)
        mixing, means, covariances = maximisation(x, gamma, floor=0.0)
        for j in range(3):
            count = sum(float(gamma[i, j]) for i in range(20))
            mean = sum(gamma[i, j] * x[i] for i in range(20)) / count
            covariance = sum(gamma[i, j] * torch.outer(x[i] - mean, x[i] - mean) for i in range(20)) / count
            assert float(mixing[j]) == pytest.approx(count / 20)
            assert torch.allclose(means[j], mean)
            assert torch.allclose(covariances[j], covariance)

    @pytest.mark.parametrize("seed", range(6))
    @pytest.mark.parametrize("k", [1, 2, 4])
    def test_the_likelihood_never_falls(self, k: int, seed: int):
        x, _ = clusters(seed=seed)
        history = expectation_maximisation(x, start(len(x), k, seed), k).history
        assert len(history) >= 2
        assert all(later >= earlier - 1e-10 for earlier, later in itertools.pairwise(history))
        assert k == 1 or history[-1] > history[0] + 1e-3

    @pytest.mark.parametrize("seed", range(3))
    def test_agrees_with_scikit_learn_from_the_same_start(self, seed: int):
        mixture_module = pytest.importorskip("sklearn.mixture")
        x, _ = clusters(seed=seed)
        labels = start(len(x), 4, seed)
        ours = expectation_maximisation(x, labels, 4)
        assert ours.converged
        onehot = torch.nn.functional.one_hot(labels, 4).double()
        mixing, means, covariances = maximisation(x, onehot, floor=0.0)
        theirs = mixture_module.GaussianMixture(
            4,
            tol=0,
            reg_covar=0,
            max_iter=len(ours.history) - 1,
            weights_init=mixing.numpy(),
            means_init=means.numpy(),
            precisions_init=torch.linalg.inv(covariances).numpy(),
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            theirs.fit(x.numpy())
        np.testing.assert_allclose(ours.means.numpy(), theirs.means_, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(ours.covariances.numpy(), theirs.covariances_, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(ours.mixing.numpy(), theirs.weights_, rtol=1e-5)
        np.testing.assert_allclose(ours.responsibilities.numpy(), theirs.predict_proba(x.numpy()), atol=1e-5)
        assert ours.history[-1] == pytest.approx(theirs.score(x.numpy()), rel=1e-8)

    def test_finds_planted_clusters(self):
        x, truth = clusters((60, 40, 30, 20), seed=3)
        x = x + 30 * torch.nn.functional.one_hot(truth, 4)
        labels = expectation_maximisation(x, k_means(x, 4, torch.Generator().manual_seed(0)), 4).responsibilities
        best = max(
            float((torch.tensor(order)[labels.argmax(1)] == truth).double().mean())
            for order in itertools.permutations(range(4))
        )
        assert best == 1

    def test_k_means_puts_each_point_to_its_nearest_centre(self):
        x, _ = clusters()
        labels = k_means(x, 4, torch.Generator().manual_seed(0))
        centres = torch.stack([x[labels == j].mean(0) for j in range(4)])
        distance = (x[:, None] - centres).square().sum(-1)
        assert torch.equal(distance.argmin(1), labels)

    @pytest.mark.usefixtures("must_end")
    @pytest.mark.parametrize("spread", [1e-9, 1e-12])
    def test_k_means_of_points_that_almost_coincide(self, spread: float):
        """Distances by way of |x|^2 - 2 x c + |c|^2 are noise here: labels that flip for ever."""
        g = torch.Generator().manual_seed(0)
        x = torch.ones(60, 4, dtype=torch.float64)
        x[30:] += spread * torch.randn(30, 4, generator=g, dtype=torch.float64)
        labels = k_means(x, 2, g)
        assert set(labels.tolist()) <= {0, 1}


class TestCoordinates:
    def test_are_those_of_the_singular_value_decomposition(self):
        """(S V^T) of B = U S V^T, not centred: equal up to the sign of each axis."""
        b = torch.randn(500, 12, generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 1
        x = subspace_coordinates(b.T @ b, 4)
        _, s, vh = torch.linalg.svd(b, full_matrices=False)
        expected = (s[:4, None] * vh[:4]).T
        assert x.shape == (12, 4)
        signs = torch.sign((x * expected).sum(0))
        assert torch.allclose(x * signs, expected, atol=1e-8 * float(s[0]))


class TestFit:
    def test_on_the_default_library(self, default_library: MaterialLibrary):
        classes = MaterialClasses.fit(default_library)
        assert classes.n_classes == 4
        assert classes.converged
        assert_sound(classes)
        assert (classes.mixing.shape, classes.means.shape, classes.covariances.shape) == ((4,), (4, 4), (4, 4, 4))
        assert float(classes.mixing.sum()) == pytest.approx(1)
        assert classes.responsibilities.shape == (348, 4)
        for j in range(4):
            assert len(classes.members(j)) == classes.sizes[j]
            assert (classes.labels[classes.members(j)] == j).all()
        assert all(b >= a - 1e-9 for a, b in itertools.pairwise(classes.history))

    def test_four_kinds_of_the_default_library(self, default_library: MaterialLibrary):
        """The paper's sizes are 137, 99, 24, 40, an independent run on decoded tables gave 141, 102, 29, 28."""
        merl = default_library.subset([name for name in default_library.names if name in MERL_MATERIALS])
        classes = MaterialClasses.fit(merl)
        found = sorted(classes.sizes, reverse=True)
        assert [abs(a - b) <= 8 for a, b in zip(found, (141, 102, 29, 28), strict=True)] == [True] * 4, found

        def label(name: str) -> set[int]:
            first = 3 * merl.names.index(name)
            return set(classes.labels[first : first + 3].tolist())

        assert label("white-diffuse-bball") == label("pink-felt") == label("blue-rubber")
        assert len({*label("white-diffuse-bball"), *label("specular-red-phenolic"), *label("chrome-steel")}) >= 3

    @pytest.mark.parametrize("seed", [1, 2, 12345])
    def test_same_for_the_same_seed_and_for_others(self, default_library: MaterialLibrary, seed: int):
        base = MaterialClasses.fit(default_library)
        once, twice = (MaterialClasses.fit(default_library, seed=seed) for _ in range(2))
        for (name, a), (_, b) in zip(once.named_buffers(), twice.named_buffers(), strict=True):
            assert torch.equal(a, b), name
        assert int((once.labels != base.labels).sum()) <= 3, "the classes depend on the seed"

    def test_does_not_disturb_the_global_generator(self, default_library: MaterialLibrary):
        torch.manual_seed(7)
        expected = torch.rand(3)
        torch.manual_seed(7)
        MaterialClasses.fit(default_library)
        assert torch.equal(torch.rand(3), expected)

    @pytest.mark.parametrize("scale", [2.0**-40, 2.0**40])
    def test_scale_of_all_materials_changes_no_class(self, default_library: MaterialLibrary, scale: float):
        louder = replace(default_library.stored, gram=default_library.stored.gram * scale**2)
        base = MaterialClasses.fit(default_library)
        assert torch.equal(MaterialClasses.fit(MaterialLibrary._whole(louder)).labels, base.labels)

    def test_number_of_classes_and_dimensions(self, default_library: MaterialLibrary):
        for k, n in ((1, 4), (2, 3), (3, 2)):
            classes = MaterialClasses.fit(default_library, n_classes=k, n_dims=n)
            assert classes.means.shape == (k, n)
            assert_sound(classes)

    def test_single(self, tiny_library: MaterialLibrary):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            classes = MaterialClasses.single(tiny_library)
        assert classes.sizes == [30]
        assert (classes.names, classes.library) == (tiny_library.names, tiny_library.source)

    @pytest.mark.parametrize(("k", "n"), [(0, 4), (4, 0), (-1, 4)])
    def test_impossible_numbers(self, tiny_library: MaterialLibrary, k: int, n: int):
        with pytest.raises(ValueError, match=f"n_classes and n_dims must be at least 1, got {k} and {n}"):
            MaterialClasses.fit(tiny_library, n_classes=k, n_dims=n)

    def test_table_names_every_material_and_splits_channels(self, default_library: MaterialLibrary):
        classes = MaterialClasses.fit(default_library, n_classes=2)
        lines = classes.table().splitlines()
        assert classes.n_classes == 2
        heads = [line for line in lines if not line.startswith(" ")]
        assert heads == [f"class {j}: {classes.sizes[j]} basis BRDFs" for j in range(2)]
        found = {}
        for j, block in enumerate(classes.table().split("class ")[1:]):
            for line in block.splitlines()[1:]:
                name, _, channels = line.strip().partition(" ")
                for channel in channels.strip("()") or "RGB":
                    found[name, channel] = j
        expected = {
            (name, "RGB"[c]): int(classes.labels[3 * i + c])
            for i, name in enumerate(default_library.names)
            for c in range(3)
        }
        assert found == expected

    def test_is_a_module_with_buffers(self, default_library: MaterialLibrary):
        classes = MaterialClasses.fit(default_library, n_classes=2)
        assert list(classes.parameters()) == []
        state = classes.state_dict()
        assert {"mixing", "means", "covariances", "responsibilities", "labels"} <= set(state)
        other = MaterialClasses.fit(default_library, n_classes=2, seed=5)
        other.load_state_dict(state)
        assert torch.equal(other.labels, classes.labels)
        assert f"{classes.sizes}" in repr(classes)


@pytest.mark.usefixtures("must_end")
class TestDegenerate:
    """Few or identical materials: fewer classes with a warning, never NaN."""

    def test_identical_materials(self, tiny_tables: dict[str, MerlTable]):
        """30 columns, 3 different ones: there are no four classes of at least five to be found."""
        library = MaterialLibrary.from_tables(scaled_copies(tiny_tables["plastic-0.2"], [1.0] * 10))
        classes = fit_with_warning(library, r"supports \d material class(es)?, not 4")
        assert classes.n_classes < 4
        assert_sound(classes)

    def test_materials_that_differ_only_in_brightness(self, tiny_tables: dict[str, MerlTable]):
        """Grey: 30 columns, 10 different ones, on a line. What lies off the line is rounding, not material."""
        grey = MerlTable.from_function(lambda a, b: (0.3 + a[..., 2:] * b[..., 2:]).expand(*a.shape[:-1], 3))
        library = MaterialLibrary.from_tables(scaled_copies(grey, [1 + 0.25 * i for i in range(10)]))
        classes = fit_with_warning(library, r"supports \d material class(es)?, not 4")
        assert classes.n_classes < 4
        assert_sound(classes)

    def library_of(self, columns: Tensor, tiny_library: MaterialLibrary) -> MaterialLibrary:
        """Ten materials whose 30 columns are given: only their Gram matrix counts."""
        return MaterialLibrary._whole(replace(tiny_library.stored, gram=columns.T @ columns))

    @pytest.mark.parametrize("noise", [1e-9, 1e-8, 1e-7])
    def test_materials_that_differ_by_less_than_any_measurement(self, tiny_library: MaterialLibrary, noise: float):
        g = torch.Generator().manual_seed(0)
        one = torch.rand(200, 1, generator=g, dtype=torch.float64)
        columns = one * (1 + noise * torch.randn(200, 30, generator=g, dtype=torch.float64))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert_sound(MaterialClasses.fit(self.library_of(columns, tiny_library)))

    def test_five_brdfs_six_times_over(self, tiny_library: MaterialLibrary):
        """Four classes of at least five different members would take twenty different BRDFs."""
        g = torch.Generator().manual_seed(0)
        five = torch.rand(200, 5, generator=g, dtype=torch.float64) * torch.tensor([1.0, 2.0, 5.0, 9.0, 20.0])
        library = self.library_of(five.repeat(1, 6), tiny_library)
        classes = fit_with_warning(library, r"supports 1 material class, not 4")
        assert_sound(classes)

    def test_duplicates_stay_together(self, tiny_tables: dict[str, MerlTable]):
        """The same material twice under two names belongs to the same class twice."""
        some = list(tiny_tables.values())[1::2]
        twice = [MerlTable(t.values, t.valid, t.name + suffix) for t in some for suffix in ("", "-b")]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            classes = MaterialClasses.fit(MaterialLibrary.from_tables(twice))
        assert_sound(classes)
        pairs = classes.labels.reshape(5, 2, 3)
        assert torch.equal(pairs[:, 0], pairs[:, 1])

    @pytest.mark.parametrize("count", [1, 2])
    def test_one_or_two_materials(self, tiny_library: MaterialLibrary, count: int):
        library = tiny_library.subset(tiny_library.names[4 : 4 + count])
        classes = fit_with_warning(library, "supports 1 material class, not 4")
        assert classes.sizes == [3 * count]
        assert_sound(classes)

    def test_black_materials_among_others(self, tiny_library: MaterialLibrary):
        lit = torch.arange(30) >= 9
        library = MaterialLibrary._whole(replace(tiny_library.stored, gram=tiny_library.gram * lit * lit[:, None]))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            classes = MaterialClasses.fit(library)
        assert_sound(classes)

    def test_all_black(self, tiny_tables: dict[str, MerlTable]):
        library = MaterialLibrary.from_tables(scaled_copies(tiny_tables["red"], [0.0] * 3))
        with pytest.raises(ValueError, match="every basis BRDF is zero"):
            MaterialClasses.fit(library)


class TestKept:
    def test_the_second_fit_reads_the_first(self, default_library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch):
        first = MaterialClasses.fit(default_library, seed=7)
        monkeypatch.setattr("torchbrdf.estimation.classes.fit_mixture", lambda *_: pytest.fail("fitted again"))
        second = MaterialClasses.fit(default_library, seed=7)
        assert second.history == first.history
        assert second.converged == first.converged
        assert all(torch.equal(value, first.state_dict()[name]) for name, value in second.state_dict().items())

    def test_a_damaged_file_is_not_read(self, default_library: MaterialLibrary, own_cache: Path):
        first = MaterialClasses.fit(default_library, seed=8)
        for path in (own_cache / "classes").iterdir():
            content = bytearray(path.read_bytes())
            content[-9] ^= 0x40
            path.write_bytes(content)
        assert torch.equal(MaterialClasses.fit(default_library, seed=8).means, first.means)
