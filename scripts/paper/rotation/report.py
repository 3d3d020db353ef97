"""The tables of scripts/rotation_robustness.py, in the layout of [CBP21] and with its figures beside ours."""

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from paper.rotation.plots import write_plots
from paper.rotation.published import LAYOUT, PAPER_1, PAPER_2, PAPER_3
from paper.rotation.results import Facts, Results, class_columns, comparisons, growth, joined, shares
from torchbrdf.experiments import Rows, markdown_table, replace_results
from torchbrdf.files import writing


def number(value: float) -> str:
    """Two decimals as in [CBP21], none above 1000."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.2f}"


def per_cent(values: np.ndarray) -> str:
    return f"{100 * values.mean():.1f}" if len(values) else ""


def cell(values: np.ndarray, paper: float | None) -> str:
    """Mean / median, and the paper's figure."""
    if not len(values):
        return ""
    text = f"{number(float(values.mean()))} / {number(float(np.median(values)))}"
    return text if paper is None else f"{text} [{paper:.2f}]"


def likelihood_table(results: Results, noise: str, method: str, reading: str) -> str:
    """Table I."""
    kinds, names = class_columns(results)
    lines = []
    for probe in results.probes:
        for angle in results.angles:
            turned, true = results.turned(method, noise, probe, angle)
            values = growth(turned, true, reading)
            paper = PAPER_1.get((probe, angle)) if method == "paper" else None
            known = dict(zip(LAYOUT, paper or [None] * 4, strict=True))
            lines.append([probe, f"{angle}°", *(cell(values[turned.kind == j], known.get(j)) for j in kinds)])
    return markdown_table(("light probe", "rot.", *names), lines)


def novel_table(results: Results, noise: str, methods: Sequence[str], materials: frozenset[str]) -> str:
    """Novel-light errors of Table I's reconstructions, of the same materials by every method."""
    kinds, names = class_columns(results)
    lines = []
    for probe, angle, method in product(results.probes, [0, *results.angles], methods):
        series = results.turned(method, noise, probe, angle)[0] if angle else results.of(method, noise, probe)
        series = series.only(materials)
        errors = series.novel
        lines.append([
            probe, f"{angle}°", method, *(per_cent(errors[series.kind == j]) for j in kinds),
            per_cent(errors), f"{100 * np.median(errors):.1f}", f"{100 * np.quantile(errors, 0.9):.1f}",
        ])  # fmt: skip
    return markdown_table(("light probe", "rot.", "method", *names, "all", "median", "90 %"), lines)


def stability_table(results: Results, noise: str, method: str) -> str:
    """Table II; its last columns are E of every photograph itself / E at 0 degrees, and novel light."""
    kinds, names = class_columns(results)
    lines = []
    for angle in results.lights:
        now, before = results.relit(method, noise, angle)
        values, changed = growth(now, before, "true"), 100 * (now.chosen != before.chosen).mean()
        paper = PAPER_2.get(angle) if method == "paper" else None
        known = dict(zip(LAYOUT, paper or [None] * 5, strict=False))
        lines.append([
            f"{angle}°", *(cell(values[now.kind == j], known.get(j)) for j in kinds),
            f"{changed:.2f} %" + (f" [{paper[4]:g} %]" if paper else ""), cell(now.error / before.error, None),
            per_cent(now.novel), per_cent(before.novel),
        ])  # fmt: skip
    header = ("angle", *names, "change class", "own E / E at 0°", "novel light, %", "at 0°, %")
    return markdown_table(header, lines)


def class_count_table(results: Results, facts: Facts, noise: str) -> str:
    """Table III."""
    counts = results.mixtures(0)
    lines = []
    for k in counts:
        fits = facts.mixtures[k, 4]
        won = shares(results, noise, (k, 4))
        won += [0.0] * (max(k, len(won)) - len(won))
        paper = PAPER_3.get(k, ())
        cells = [f"{share:.2f}" + (f" [{paper[i]:.2f}]" if i < len(paper) else "") for i, share in enumerate(won)]
        cells += [""] * (max(counts) - len(cells))
        had = f"{fits.fewest}" if fits.fewest == fits.most else f"{fits.fewest} to {fits.most}"
        novel = joined([results.of("paper", noise, probe, mixture=(k, 4)) for probe in results.probes]).novel
        lines.append([str(k), had, *cells, per_cent(novel), f"{100 * np.median(novel):.1f}"])
    header = ("K", "classes had", *(str(i + 1) for i in range(max(counts))), "novel light, %", "median")
    return markdown_table(header, lines)


def dimension_table(results: Results, facts: Facts, noise: str) -> str:
    """N = 2 ... 10."""
    lines = []
    for n in results.mixtures(1):
        fits = facts.mixtures[4, n]
        now, usual = (
            joined([results.of("paper", noise, probe, mixture=mixture) for probe in results.probes])
            for mixture in ((4, n), (4, 4))
        )
        lines.append([
            str(n), " + ".join(map(str, fits.sizes)), f"{100 * fits.as_usual:.0f} %", f"{100 * fits.steady:.1f} %",
            f"{100 * (now.chosen != usual.chosen).mean():.1f} %", per_cent(now.novel),
            f"{100 * np.median(now.novel):.1f}",
        ])  # fmt: skip
    header = ("N", "basis BRDFs of each class", "as with N = 4", "steady", "another class won", "novel light, %")
    return markdown_table((*header, "median"), lines)


def sections(results: Results, facts: Facts) -> Iterator[str]:
    """The tables that were computed: the paper's at the first noise level, novel light at the last."""
    noise, last = results.noise[0], results.noise[-1]
    if results.angles:
        for reading, light in (("believed", "the light as it was believed"), ("true", "the true light")):
            yield f"## Table I: relative log-likelihood error under {light}"
            for method in results.methods:
                level = noise if method == "paper" else last  # without noise others leave next to nothing to grow from
                yield f"{counted(results, method, level)}\n\n{likelihood_table(results, level, method, reading)}"
        for methods, materials in comparisons(results):
            yield f"## Table I: novel-light error in per cent, {last} % noise, {len(materials)} materials"
            yield novel_table(results, last, methods, materials)
    if results.lights:
        yield "## Table II: relative log-likelihood error under the light at 0°"
        for method in results.relit_methods:
            yield f"{counted(results, method, noise)}\n\n{stability_table(results, noise, method)}"
    if len(results.mixtures(0)) > 1:
        yield f"## Table III: reconstructions that each class wins, in per cent, {noise} % noise"
        yield class_count_table(results, facts, noise)
        yield f"## Dimensions N, K = 4, {noise} % noise"
        yield dimension_table(results, facts, noise)


def counted(results: Results, method: str, noise: str) -> str:
    """A method, how many materials it has, and the noise."""
    return f"`{method}`, {len(results.of(method, noise, results.probes[0]).materials)} materials, {noise} % noise:"


def summary(results: Results, facts: Facts) -> str:
    """The Markdown page."""
    sizes = ", ".join(map(str, facts.mixtures[4, 4].sizes))
    head = (
        f"{facts.materials} materials, the probes {', '.join(results.probes)}; {facts.size} x {facts.size} pixels; "
        f"classes of {sizes} basis BRDFs. Tables I and II by the class of the material in the whole library. Pairs are "
        "mean / median; figures in square brackets are those of the paper, under its own four probes."
    )
    return "\n\n".join(["# Robustness to the light", head, *sections(results, facts)]) + "\n"


def write_report(out: Path, rows: Rows, facts: Facts, document: Path | None = None) -> None:
    """Write summary.md and the plots.

    document  a Markdown file whose part between the markers becomes the summary; the plots
              go to figures/ beside it
    """
    results = Results(rows, len(facts.mixtures[4, 4].sizes))
    text = summary(results, facts)
    with writing(out / "summary.md") as temporary:
        temporary.write_text(text)
    write_plots(results, out)
    if document is not None:
        replace_results(document, text.split("\n\n", 1)[1])
        (document.parent / "figures").mkdir(exist_ok=True)
        write_plots(results, document.parent / "figures")
