"""The rows of scripts/rotation_robustness.py, and selections of them that tables and plots share."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from paper.leave_one_out_report import Table
from paper.rotation.published import CLASS_NAMES, LAYOUT
from torchbrdf.experiments import Rows

Key = tuple[str, str, str, str, str, str, str]

_KEY = ("method", "noise_percent", "probe", "photographed", "believed", "n_classes", "n_dims")

UNTURNED = "0"


@dataclass(frozen=True)
class MixtureFacts:
    """Of the fits of K classes in N dimensions.

    sizes          basis BRDFs of each class of the whole library
    fewest, most   classes of the libraries without one material
    steady         share of basis BRDFs that stay in their class when a material is left out, mean over materials
    as_usual       share of basis BRDFs of the whole library in the class that K = 4 and N = 4 gives them
    """

    sizes: list[int]
    fewest: int
    most: int
    steady: float
    as_usual: float


@dataclass(frozen=True)
class Facts:
    """What the tables say about the run itself; mixtures by K and N."""

    materials: int
    size: int
    mixtures: Mapping[tuple[int, int], MixtureFacts]


@dataclass(frozen=True)
class Series:
    """Reconstructions of the same materials in the same order, one row of a table.

    error        (m,) E, |Y w - y|^2 under the believed light
    own, novel   (m,) |rendered - truth| / |truth| under the observed probe as it is, and under the others
    kind, chosen (m,) the class of the material, and that of the reconstruction
    """

    materials: tuple[str, ...]
    error: np.ndarray
    own: np.ndarray
    novel: np.ndarray
    kind: np.ndarray
    chosen: np.ndarray

    def only(self, materials: frozenset[str]) -> "Series":
        """Of some materials."""
        keep = np.array([name in materials for name in self.materials])
        names = tuple(name for name in self.materials if name in materials)
        return Series(names, *(part[keep] for part in (self.error, self.own, self.novel, self.kind, self.chosen)))


class Results:
    """The rows of results.csv as series."""

    def __init__(self, rows: Rows, n_classes: int) -> None:
        """Group them; n_classes of the whole library."""
        table, self.n_classes = Table(rows), n_classes
        self.methods, self.noise, self.probes = (table.unique(key) for key in _KEY[:3])
        keys = list(zip(*(table.columns[key] for key in _KEY), strict=True))
        places: dict[Key, list[int]] = {}
        for i, key in enumerate(keys):
            places.setdefault(key, []).append(i)
        columns = ("error", "own_light_error", "novel_error", "material_class", "class")
        numbers = [table.columns[key].astype(float) for key in columns]
        names = table.columns["material"]
        self.series = {
            key: Series(tuple(names[some].tolist()), *(part[some] for part in numbers)) for key, some in places.items()
        }

    def of(
        self, method: str, noise: str, probe: str, photographed: str = UNTURNED, believed: str = UNTURNED,
        mixture: tuple[int, int] = (4, 4),
    ) -> Series:  # fmt: skip
        """One series; raises KeyError where it was not computed."""
        k, n = mixture
        return self.series[method, noise, probe, photographed, believed, str(k), str(n)]

    def turned(self, method: str, noise: str, probe: str, angle: int) -> tuple[Series, Series]:
        """Table I: all axes one behind the other, and as often the series under the true light."""
        parts = [self.of(method, noise, probe, believed=turn) for turn in self.axes(angle)]
        return joined(parts), joined([self.of(method, noise, probe)] * len(parts))

    def relit(self, method: str, noise: str, angle: int) -> tuple[Series, Series]:
        """Table II: all probes one behind the other, turned with the light and as they are."""
        turn = f"{angle}Y"
        now = [self.of(method, noise, probe, turn, turn) for probe in self.probes]
        return joined(now), joined([self.of(method, noise, probe) for probe in self.probes])

    def axes(self, angle: int) -> list[str]:
        """The turns by so many degrees."""
        found = {key[4] for key in self.series if key[3] == UNTURNED and key[4] != UNTURNED}
        return sorted(turn for turn in found if turn[:-1] == str(angle))

    @property
    def angles(self) -> list[int]:
        """Of Table I."""
        return sorted({int(key[4][:-1]) for key in self.series if key[3] == UNTURNED and key[4] != UNTURNED})

    @property
    def lights(self) -> list[int]:
        """The angles of Table II."""
        return sorted({int(key[3][:-1]) for key in self.series if key[3] != UNTURNED})

    @property
    def relit_methods(self) -> list[str]:
        """The methods of Table II."""
        found = {key[0] for key in self.series if key[3] != UNTURNED}
        return [method for method in self.methods if method in found]

    def mixtures(self, of: int) -> list[int]:
        """Values of K (of = 0, with N = 4) or of N (of = 1, with K = 4)."""
        pairs = {(int(key[5]), int(key[6])) for key in self.series if key[0] == "paper"}
        return sorted({pair[of] for pair in pairs if pair[1 - of] == 4})


def joined(parts: Sequence[Series]) -> Series:
    """One behind the other."""
    numbers = ("error", "own", "novel", "kind", "chosen")
    names = tuple(name for part in parts for name in part.materials)
    return Series(names, *(np.concatenate([getattr(part, key) for part in parts]) for key in numbers))


def class_columns(results: Results) -> tuple[list[int], list[str]]:
    """The classes of the materials in the paper's order, and their names."""
    kinds = {int(kind) for series in results.series.values() for kind in series.kind}
    if results.n_classes == len(CLASS_NAMES):
        return [j for j in LAYOUT if j in kinds], [CLASS_NAMES[j] for j in LAYOUT if j in kinds]
    return sorted(kinds), [f"class {j}" for j in sorted(kinds)]


def growth(now: Series, before: Series, reading: str) -> np.ndarray:
    """(E - E_before) / E_before, with E that of `now` under the `believed` light, or under the probe as it is."""
    if reading == "believed":
        return now.error / before.error - 1
    return (now.own / before.own) ** 2 - 1


def comparisons(results: Results) -> list[tuple[list[str], frozenset[str]]]:
    """Methods that have the same materials, and these: the most materials first, all methods last."""
    first = results.noise[0], results.probes[0]
    having = {method: frozenset(results.of(method, *first).materials) for method in results.methods}
    found = []
    for materials in sorted(set(having.values()), key=len, reverse=True):
        methods = [method for method in results.methods if having[method] >= materials]
        if len(methods) > 1 or len(having) == 1:
            found.append((methods, materials))
    return found


def shares(results: Results, noise: str, mixture: tuple[int, int]) -> list[float]:
    """Percentages of the paper's reconstructions that each class wins, the largest first."""
    chosen = joined([results.of("paper", noise, probe, mixture=mixture) for probe in results.probes]).chosen
    return sorted((100 * count / len(chosen) for count in Counter(chosen.tolist()).values()), reverse=True)
