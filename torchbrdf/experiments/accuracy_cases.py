"""Cases of `accuracy` and tables of them."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchbrdf.experiments.tables import markdown_table, percent

FLOOR = "floor"


@dataclass(frozen=True)
class Case:
    """One material, observed under one probe and shown under another; errors and noise are fractions.

    noise        of the pixels of the observation, in per cent
    own_noise    of the target under the novel probe
    """

    setting: str
    noise: float
    material: str
    observed: str
    novel: str
    observation_error: float
    novel_error: float
    own_noise: float

    @property
    def less_noise(self) -> float:
        """The error without what the target's own noise adds."""
        return max(0.0, self.novel_error**2 - self.own_noise**2) ** 0.5


def summary_table(cases: Sequence[Case]) -> str:
    """Table: a row for each setting of cases with one noise level and the floor."""
    head = [*"method|observation|novel: mean|median|90 %|worst|less noise|better than naive|worst case".split("|")]
    naive = {case_key(case): case.novel_error for case in cases if case.setting == "naive"}
    rows = []
    for name, some in grouped(cases, "setting").items():
        errors = sorted(case.novel_error for case in some)
        worst = max(some, key=lambda case: case.novel_error)
        wins = [case.novel_error < naive[case_key(case)] for case in some if case_key(case) in naive]
        rows.append(
            [
                name,
                percent(statistics.mean(case.observation_error for case in some)),
                percent(statistics.mean(errors)),
                percent(statistics.median(errors)),
                percent(float(torch.quantile(torch.tensor(errors), 0.9))),
                percent(errors[-1]),
                percent(statistics.mean(case.less_noise for case in some)),
                f"{100 * statistics.mean(wins):.0f} %" if wins and name != "naive" else "",
                f"{worst.material}, {worst.observed} → {worst.novel}",
            ]
        )
    return markdown_table(head, rows)


def breakdown_table(cases: Sequence[Case], by: str) -> str:
    """Table of "observation / novel light" means: a row for each material or probe, a column for each setting."""
    columns = grouped(cases, "setting")
    rows = []
    for key in grouped(cases, by):
        cells = []
        for some in columns.values():
            inside = [case for case in some if getattr(case, by) == key]
            if not inside:  # not observed under this probe
                cells.append("")
                continue
            observation = statistics.mean(case.observation_error for case in inside)
            cells.append(f"{percent(observation)} / {percent(statistics.mean(case.novel_error for case in inside))}")
        rows.append([key, *cells])
    return markdown_table([by, *columns], rows)


def grouped(cases: Sequence[Case], by: str) -> dict[str, list[Case]]:
    """Cases by the value of a field, in order of appearance."""
    groups: dict[str, list[Case]] = {}
    for case in cases:
        groups.setdefault(getattr(case, by), []).append(case)
    return groups


def case_key(case: Case) -> tuple[str, str, str]:
    """What was measured, whichever way."""
    return case.material, case.observed, case.novel
