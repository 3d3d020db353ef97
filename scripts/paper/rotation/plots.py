"""The plots of scripts/rotation_robustness.py."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from paper.rotation.published import LAYOUT, PAPER_1, PAPER_2, PAPER_3
from paper.rotation.results import Results, class_columns, comparisons, growth, joined, shares
from torchbrdf.files import writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"paper": "#0072b2", "auto": "#009e73", "aligned": "#d55e00"}
_MORE = ("#cc79a7", "#e69f00", "#56b4e9")
_MARKERS = "osv^Dx*"


def write_plots(results: Results, folder: Path) -> None:
    """rotation_novel.png, rotation_likelihood.png, rotation_relit.png and rotation_classes.png, as far as computed."""
    if results.angles:
        save(novel_plot(results), folder / "rotation_novel.png")
        save(likelihood_plot(results), folder / "rotation_likelihood.png")
    if results.lights:
        save(relit_plot(results), folder / "rotation_relit.png")
    if len(results.mixtures(0)) > 1:
        save(class_plot(results), folder / "rotation_classes.png")


def save(figure: "Figure", path: Path) -> None:
    with writing(path) as temporary:
        figure.savefig(temporary, dpi=110)


def panels(count: int, height: float = 3.3, share: bool = True) -> tuple["Figure", list["Axes"]]:
    """A row of them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.2 + 2.9 * count, height), layout="constrained")
    axes = figure.subplots(1, count, sharey=share, squeeze=False)[0]
    for axis in axes:
        axis.grid(alpha=0.3, which="both", linewidth=0.5)
    return figure, list(axes)


def colour(results: Results, method: str) -> str:
    others = [name for name in results.methods if name not in COLOURS]
    return COLOURS[method] if method in COLOURS else _MORE[others.index(method) % len(_MORE)]


def novel_plot(results: Results) -> "Figure":
    """Table I as users feel it: a panel a probe, a colour a method."""
    angles, noise = [0, *results.angles], results.noise[-1]
    methods, shared = comparisons(results)[-1]
    figure, axes = panels(len(results.probes))
    for axis, probe in zip(axes, results.probes, strict=True):
        for method in methods:
            errors = [results.of(method, noise, probe).only(shared).novel]
            errors += [results.turned(method, noise, probe, angle)[0].only(shared).novel for angle in results.angles]
            for name, style, values in (
                ("mean", "-", [part.mean() for part in errors]),
                ("median", "--", [np.median(part) for part in errors]),
            ):
                axis.plot(
                    range(len(angles)), 100 * np.array(values), style, marker="o", markersize=3,
                    color=colour(results, method), label=f"{method}, {name}",
                )  # fmt: skip
        axis.set(title=f"observed under {probe}", xlabel="probe turned by", yscale="log")
        axis.set_xticks(range(len(angles)), [f"{angle}°" for angle in angles])
        axis.yaxis.set_major_formatter("{x:g}")
    axes[0].set_ylabel(f"error under novel light, %\n({noise} % noise, {len(shared)} materials)")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
    return figure


def likelihood_plot(results: Results) -> "Figure":
    """Table I in the paper's layout: a panel a class, medians of ours beside the paper's means."""
    kinds, names = class_columns(results)
    noise = results.noise[0]
    figure, axes = panels(len(kinds))
    for axis, kind, name in zip(axes, kinds, names, strict=True):
        for i, probe in enumerate(results.probes):
            pairs = [results.turned("paper", noise, probe, angle) for angle in results.angles]
            values = [growth(turned, true, "believed")[turned.kind == kind] for turned, true in pairs]
            look: dict[str, Any] = {"marker": _MARKERS[i % len(_MARKERS)], "markersize": 4, "color": f"C{i}"}
            axis.plot(results.angles, [part.mean() for part in values], "-", label=f"{probe}, mean", **look)
            axis.plot(results.angles, [np.median(part) for part in values], "--", label=f"{probe}, median", **look)
            if kind in LAYOUT and (probe, results.angles[0]) in PAPER_1:
                known = [PAPER_1[probe, angle][LAYOUT.index(kind)] for angle in results.angles]
                axis.plot(results.angles, known, ":", label=f"{probe}, [CBP21]", **look)
        axis.set(title=name, xlabel="probe turned by, degrees", xscale="log", yscale="log")
        axis.set_xticks(results.angles, [str(angle) for angle in results.angles])
        axis.minorticks_off()
    axes[0].set_ylabel(f"relative log-likelihood error under the\nbelieved light (paper's method, {noise} % noise)")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
    return figure


def relit_plot(results: Results) -> "Figure":
    """Table II: a panel a class, and one for changed classes."""
    kinds, names = class_columns(results)
    noise, lights = results.noise[0], results.lights
    figure, axes = panels(len(kinds) + 1, share=False)
    for method in results.relit_methods:
        pairs = [results.relit(method, noise, angle) for angle in lights]
        look: dict[str, Any] = {"color": colour(results, method), "marker": "o", "markersize": 3}
        for axis, kind, name in zip(axes, kinds, names, strict=False):
            values = [growth(now, before, "true")[now.kind == kind] for now, before in pairs]
            axis.plot(lights, [part.mean() for part in values], "-", label=f"{method}, mean", **look)
            axis.plot(lights, [np.median(part) for part in values], "--", label=f"{method}, median", **look)
            axis.set(title=name, yscale="log")
        axes[-1].plot(lights, [100 * (now.chosen != before.chosen).mean() for now, before in pairs], "-", **look)
    if set(lights) <= set(PAPER_2):
        for axis, kind in zip(axes, kinds, strict=False):
            if kind in LAYOUT:
                axis.plot(lights, [PAPER_2[x][LAYOUT.index(kind)] for x in lights], "k:", label="[CBP21]")
        axes[-1].plot(lights, [PAPER_2[x][4] for x in lights], "k:")
    axes[-1].set_title("changed class, %")
    for axis in axes:
        axis.set(xlabel="light turned by, degrees")
        axis.set_xticks(lights[::2])
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}" if axis.get_ylim()[1] < 10 else "")
    axes[0].set_ylabel(f"relative log-likelihood error\nunder the light at 0° ({noise} % noise)")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
    return figure


def class_plot(results: Results) -> "Figure":
    """Table III beside the paper's, and the novel-light error over K and N."""
    noise = results.noise[0]
    counts, dimensions = results.mixtures(0), results.mixtures(1)
    figure, axes = panels(3, share=False)
    for offset, hatch, won in (
        (-0.2, "", {k: shares(results, noise, (k, 4)) for k in counts}),
        (0.2, "///", {k: list(PAPER_3.get(k, ())) for k in counts}),
    ):
        for k in counts:
            bottom = 0.0
            for i, share in enumerate(won[k]):
                axes[0].bar(
                    k + offset, share, 0.36, bottom=bottom, color=f"C{i}", hatch=hatch, edgecolor="white", linewidth=0.5
                )
                bottom += share
    axes[0].set(title="won by each class, % (right: [CBP21])", xlabel="K")
    for axis, values, of in ((axes[1], counts, 0), (axes[2], dimensions, 1)):
        mixtures = [(value, 4) if of == 0 else (4, value) for value in values]
        novel = [joined([results.of("paper", noise, p, mixture=m) for p in results.probes]).novel for m in mixtures]
        axis.plot(values, [100 * part.mean() for part in novel], "-o", markersize=3, label="mean")
        axis.plot(values, [100 * np.median(part) for part in novel], "--o", markersize=3, label="median")
        axis.set(title="error under novel light, %", xlabel="K, with N = 4" if of == 0 else "N, with K = 4")
        axis.set_xticks(values)
        axis.set_ylim(bottom=0)
    axes[1].legend(fontsize=8)
    return figure
