"""The results file, the tables and the plot of scripts/leave_one_out.py."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchbrdf.experiments import Rows, markdown_table, replace_results
from torchbrdf.files import writing

_COLOURS = {"naive": "#000000", "single": "#d55e00", "classes": "#0072b2", "auto": "#009e73"}
_BOLD = ("naive", "single-0.5", "classes-0.5", "auto")
"""The methods that [CBP21, fig. 5] compares."""

_DASHES = ((0, (6, 1)), (0, (3, 1)), (0, (1, 1)), (0, (5, 1, 1, 1)), (0, (1, 3)))
_EXAMPLES = 3


@dataclass(frozen=True)
class Facts:
    """What the tables say about the run itself.

    rendering_noise  median, 95th percentile and largest |target - own basis image| / |target| over materials and
                     probes: the same material rendered with other samples
    targets          the samples of the targets, in words
    class_members    the materials of every class of the whole library whose three channels agree
    """

    materials: int
    size: int
    samples: int
    targets: str
    rendering_noise: tuple[float, float, float]
    class_sizes: list[int]
    class_members: list[list[str]]


class Table:
    """The rows of results.csv as arrays, and selections of them."""

    def __init__(self, rows: Rows) -> None:
        """Keep the rows column by column."""
        self.columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}

    def unique(self, key: str) -> list[str]:
        """The different entries of a column, in the order of the file."""
        return list(dict.fromkeys(self.columns[key].tolist()))

    @property
    def methods(self) -> list[str]:
        """By family, the largest lambda first."""

        def rank(method: str) -> tuple[int, float]:
            family, _, penalty = method.partition("-")
            return list(_COLOURS).index(family), -float(penalty or 0)

        return sorted(self.unique("method"), key=rank)

    def where(self, **chosen: str) -> np.ndarray:
        """Which rows have these entries."""
        mask = np.ones(len(self.columns["method"]), dtype=bool)
        for key, entry in chosen.items():
            mask &= self.columns[key] == entry
        return mask

    def numbers(self, key: str, **chosen: str) -> np.ndarray:
        """A column of numbers over the rows with these entries."""
        return self.columns[key][self.where(**chosen)].astype(float)


def label(method: str) -> str:
    return {"classes-0.5": "classes-0.5 (paper)"}.get(method, method)


def error_table(table: Table, noise: str) -> str:
    header = ("method", "observation", "novel mean", "median", "90 %", "worst", "best class in hindsight",
              "light 0°", "light 136°", "log BRDF", "negative")  # fmt: skip
    lines = []
    for method in table.methods:
        chosen = {"noise_percent": noise, "method": method}
        novel = table.numbers("novel_error", **chosen)
        lines.append([
            label(method),
            f"{table.numbers('observation_error', **chosen).mean():.4f}",
            f"{novel.mean():.3f}", f"{np.median(novel):.3f}", f"{np.quantile(novel, 0.9):.3f}", f"{novel.max():.2f}",
            f"{table.numbers('best_class_error', **chosen).mean():.3f}",
            f"{np.median(table.numbers('light_0_error', **chosen)):.2f}",
            f"{np.median(table.numbers('light_136_error', **chosen)):.2f}",
            f"{table.numbers('log_error', **chosen).mean():.3f}",
            f"{100 * table.numbers('negative_share', **chosen).mean():.1f} %",
        ])  # fmt: skip
    return markdown_table(header, lines)


def by_probe_table(table: Table, side: str) -> str:
    probes = table.unique(side)
    lines = []
    for noise in table.unique("noise_percent"):
        for method in table.methods:
            errors = [table.numbers("novel_error", noise_percent=noise, method=method, **{side: p}) for p in probes]
            lines.append([f"{label(method)}, {noise} %", *(f"{e.mean():.3f}" for e in errors)])
    return markdown_table(("method, noise", *probes), lines)


def by_material_class_table(table: Table, facts: Facts, column: str) -> str:
    """Mean over the materials of each class; those with channels in different classes are left out."""
    inside = [np.isin(table.columns["material"], members) for members in facts.class_members]
    present = [j for j in range(len(inside)) if inside[j].any()]
    lines = []
    for noise in table.unique("noise_percent"):
        for method in table.methods:
            chosen = table.where(noise_percent=noise, method=method)
            means = [f"{table.columns[column][chosen & inside[j]].astype(float).mean():.3f}" for j in present]
            lines.append([f"{label(method)}, {noise} %", *means])
    counts = [len(set(table.columns["material"][inside[j]])) for j in present]
    header = [f"class {j} ({count} materials)" for j, count in zip(present, counts, strict=True)]
    return markdown_table(("method, noise", *header), lines)


def class_table(table: Table, facts: Facts) -> str:
    """How often each class was chosen: observations, so each (material, observed, noise) counts once."""
    novel_of = {probe: next(p for p in table.unique("novel") if p != probe) for probe in table.unique("observed")}
    k = len(facts.class_sizes)
    lines = []
    for method in table.methods:
        if not method.startswith("classes"):
            continue
        for noise in table.unique("noise_percent"):
            picks = np.concatenate([
                table.numbers("class", noise_percent=noise, method=method, observed=probe, novel=novel)
                for probe, novel in novel_of.items()
            ])  # fmt: skip
            lines.append([f"{label(method)}, {noise} %", *(f"{100 * (picks == j).mean():.1f} %" for j in range(k))])
    sizes = [f"class {j} ({size} columns)" for j, size in enumerate(facts.class_sizes)]
    return markdown_table(("method, noise", *sizes), lines)


def worst_table(table: Table) -> str:
    lines = []
    for noise in table.unique("noise_percent"):
        for method in table.methods:
            rows = np.nonzero(table.where(noise_percent=noise, method=method))[0]
            errors = table.columns["novel_error"][rows].astype(float)
            cases = []
            for row in rows[np.argsort(-errors)[:_EXAMPLES]]:
                material, observed, novel = (table.columns[key][row] for key in ("material", "observed", "novel"))
                cases.append(f"{material}, {observed} → {novel}: {float(table.columns['novel_error'][row]):.2f}")
            lines.append([f"{label(method)}, {noise} %", *cases])
    return markdown_table(("method, noise", *[f"worst {i + 1}" for i in range(_EXAMPLES)]), lines)


def paired_table(table: Table) -> str:
    """Method against method on the same material, pair and noise; rows of one method are in the same order."""
    methods = table.methods
    rivals = [i for i, method in enumerate(methods) if method in _BOLD]
    lines = []
    for noise in table.unique("noise_percent"):
        errors = np.stack([table.numbers("novel_error", noise_percent=noise, method=method) for method in methods])
        smallest = errors.argmin(0)
        for i, method in enumerate(methods):
            wins = ["" if i == j else f"{100 * (errors[i] < errors[j]).mean():.0f} %" for j in rivals]
            lines.append([f"{label(method)}, {noise} %", *wins, f"{100 * (smallest == i).mean():.0f} %", ""])
        lines.append([f"the best of all, {noise} %", *[""] * len(rivals), "", f"{errors.min(0).mean():.3f}"])
    header = ("method, noise", *(f"beats {methods[j]}" for j in rivals), "is best of all", "mean error")
    return markdown_table(header, lines)


def summary(rows: Rows, facts: Facts) -> str:
    table = Table(rows)
    noise = [f"### {level} % noise\n\n{error_table(table, level)}" for level in table.unique("noise_percent")]
    median, high, largest = facts.rendering_noise
    classes = [
        f"- class {j}: {', '.join(members) or 'no material with all three channels'}"
        for j, members in enumerate(facts.class_members)
    ]
    pairs = len(set(zip(table.columns["observed"], table.columns["novel"], strict=True)))
    return "\n\n".join([
        "# Leave-one-out",
        f"{facts.materials} materials, {pairs} ordered pairs of the probes {', '.join(table.unique('observed'))}; "
        f"{facts.size} x {facts.size} pixels; basis images with {facts.samples} samples a pixel, targets with "
        f"{facts.targets}. The same material rendered both ways differs by {100 * median:.2f} % "
        f"(median), {100 * high:.2f} % (95th percentile), {100 * largest:.2f} % (largest): rendering noise, "
        "on top of every level below.",
        "## Errors",
        "Observation and novel light: |rendered - target| / |target| over the pixels and channels, against the noisy "
        "observation and the clean target. Light 0° and 136°: the same for one directional light, median. Log BRDF: "
        "mean |log(1 + f cos) - log(1 + g cos)| over cells. Negative: share of negative values in the sum of |f|.",
        *noise,
        "## Mean novel-light error by observing probe", by_probe_table(table, "observed"),
        "## Mean novel-light error by class of the material",
        by_material_class_table(table, facts, "novel_error"),
        "## Mean error under the 0° light by class of the material",
        by_material_class_table(table, facts, "light_0_error"),
        "## How often each class was chosen", class_table(table, facts), "\n".join(classes),
        "## Case against case", paired_table(table),
        "## Worst cases", worst_table(table),
    ]) + "\n"  # fmt: skip


def plot(rows: Rows, path: Path) -> None:
    """Sorted novel-light errors, a curve a method, a panel a noise level."""
    from matplotlib.figure import Figure

    table = Table(rows)
    levels = table.unique("noise_percent")
    figure = Figure(figsize=(1.6 + 3.2 * len(levels), 3.6), layout="constrained")
    axes = figure.subplots(1, len(levels), sharey=True, squeeze=False)[0]
    for axis, noise in zip(axes, levels, strict=True):
        thin = dict.fromkeys(_COLOURS, 0)
        for method in table.methods:
            family = method.partition("-")[0]
            thick = method in _BOLD
            errors = np.sort(table.numbers("novel_error", noise_percent=noise, method=method))
            axis.plot(
                100 * (np.arange(len(errors)) + 0.5) / len(errors),
                errors,
                color=_COLOURS[family],
                linestyle="-" if thick else _DASHES[thin[family] % len(_DASHES)],
                linewidth=2 if thick else 1,
                label=label(method),
            )
            thin[family] += not thick
        axis.set(yscale="log", title=f"{noise} % noise", xlabel="percentile of the cases", xlim=(0, 100))
        axis.grid(alpha=0.3, which="both", linewidth=0.5)
    axes[0].set_ylabel("relative error under novel light")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
    with writing(path) as temporary:
        figure.savefig(temporary, dpi=110)


def write_report(out: Path, rows: Rows, facts: Facts, document: Path | None = None) -> None:
    """Write summary.md and errors.png.

    document  a Markdown file whose part between the markers becomes the summary; the plot goes to figures/ beside it
    """
    text = summary(rows, facts)
    with writing(out / "summary.md") as temporary:
        temporary.write_text(text)
    plot(rows, out / "errors.png")
    if document is not None:
        replace_results(document, text.split("\n\n", 1)[1])
        (document.parent / "figures").mkdir(exist_ok=True)
        plot(rows, document.parent / "figures" / f"{document.stem}.png")
