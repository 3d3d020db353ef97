"""Figures 2, 3 and 5 of [CBP21]: materials of a library, each reconstructed by all others, under other light."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from paper.figures.light import DIRECTIONAL, Light, ball_error, percent
from paper.figures.sheet import Block, Cell, Profile, Row, Sheet, Tile, enlarged, middle_line, sphere_tile
from paper.figures.studio import NAIVE, ONE_CLASS, OURS, PAPER, Studio, stored
from torchbrdf.experiments import Setting, common_exposure, markdown_table, without_relatives

SPREAD = (
    "pink-felt", "green-latex", "red-plastic", "specular-blue-phenolic", "red-specular-plastic", "gold-metallic-paint2",
    "nickel",
)  # fmt: skip
"""Of figure 2: from diffuse to metal."""

CANDIDATES = ("pink-felt", "specular-maroon-phenolic", "red-metallic-paint", "steel")
"""Of figure 3; [CBP21] names the last two."""

SPIKES = ("light-red-paint", "white-fabric", "brass", "nickel")
"""Of figure 5: two diffuse materials and two metals."""

Drawing = tuple[Sheet, str]
"""A sheet, and its numbers as a table in Markdown."""

_CALLED = {NAIVE.name: "naive", ONE_CLASS.name: "one class", PAPER.name: "paper", OURS.name: "default"}


@dataclass(frozen=True)
class Fit:
    """What a setting makes of one photograph, as weights over the whole library.

    weights     (n, 3)
    candidates  (K, n, 3)  one a class
    errors      (K,)       |Y w - y|^2 of the candidates [CBP21, eq. 19]
    error       ()         of the weights
    """

    weights: Tensor
    candidates: Tensor
    errors: Tensor
    error: Tensor


def figure_2(studio: Studio, probes: Sequence[tb.LightProbe], materials: Sequence[str]) -> Drawing:
    """[CBP21, fig. 2]: observed under the first and second probe, shown under the third and two directional lights."""
    observed, lights = probes[:2], [Light(source) for source in (probes[2], *DIRECTIONAL)]
    settings = (PAPER, OURS)
    weights = {"reference": [studio.itself(name) for name in materials]}
    with tqdm(total=len(observed) * len(materials), desc="figure 2: fits") as bar:
        for probe in observed:
            for name in materials:
                for setting, fit in zip(settings, fits(studio, materials, name, probe, settings), strict=True):
                    label = f"from {Light(probe).name},\n{_CALLED[setting.name]}"
                    weights.setdefault(label, []).append(fit.weights)
                bar.update()
    blocks, means = [], []
    for light in tqdm(lights, desc="figure 2: pictures"):
        found = iter(studio.under([one for some in weights.values() for one in some], light))
        images = {label: [next(found) for _ in some] for label, some in weights.items()}
        references = images["reference"]
        scale = light.exposure(references)
        rows = [light.row(label, some, references, scale) for label, some in images.items()]
        blocks.append(Block(light.label(scale), materials, rows))
        means.append({label: statistics.mean(map(ball_error, some, references)) for label, some in images.items()})
    head = ["mean error", *(light.name for light in lights)]
    body = [
        [label.replace("\n", " "), *(percent(mean[label]) for mean in means)] for label in weights if label in means[0]
    ]
    return Sheet(blocks), markdown_table(head, body[1:])


def figure_3(studio: Studio, probes: Sequence[tb.LightProbe], materials: Sequence[str]) -> Drawing:
    """[CBP21, fig. 3]: every class's candidate with its error on the photograph, the best one marked.

    Observed under the third probe, shown under the first and a directional light.
    """
    lights = [Light(source) for source in (probes[0], DIRECTIONAL[0])]
    blocks, body = [], []
    for name in tqdm(materials, desc="figure 3"):
        paper, naive, ours = fits(studio, materials, name, probes[2], (PAPER, NAIVE, OURS))
        best = int(paper.errors.argmin())
        columns = [*(f"class {j}" for j in range(len(paper.errors))), "naive", "default"]
        weights = [*paper.candidates, naive.weights, ours.weights]
        likelihoods = [*paper.errors.tolist(), float(naive.error), float(ours.error)]
        rows: list[Row] = []
        numbers = [[f"{value:#.3g}"] for value in likelihoods]
        noise = _residual(studio, materials, name, probes[2])
        for light in lights:
            reference, *images = studio.under([studio.itself(name), *weights], light)
            scale = light.exposure([reference])
            cells: list[Cell] = [Tile(sphere_tile(reference, scale), "" if rows else f"eq. 19: {noise:#.3g}")]
            for j, image in enumerate(images):
                caption = light.caption(image, reference)
                if not rows:
                    caption = f"eq. 19: {likelihoods[j]:#.3g}\n{caption}"
                cells.append(Tile(sphere_tile(image, scale), caption, marked=j == best))
                numbers[j].append(percent(ball_error(image, reference)))
            rows.append(Row(light.label(scale).replace(", ", ",\n"), cells))
        blocks.append(Block(name, ["reference", *columns], rows))
        body.append([f"{name}, the material itself", f"{noise:#.3g}", *(["0"] * len(lights))])
        for j, column in enumerate(columns):
            body.append([f"{name}, {column}" + (" (best)" if j == best else ""), *numbers[j]])
    return Sheet(blocks), markdown_table(["candidate", "eq. 19", *(light.name for light in lights)], body)


def figure_5(studio: Studio, probes: Sequence[tb.LightProbe], materials: Sequence[str]) -> Drawing:
    """[CBP21, fig. 5]: naive, one class, four classes; spikes and ringing under a directional light.

    Observed under the second probe, shown under the first.
    """
    observed, lights = probes[1], [Light(source) for source in (probes[0], DIRECTIONAL[0])]
    settings = (NAIVE, ONE_CLASS, PAPER, OURS)
    blocks, body = [], []
    for name in tqdm(materials, desc="figure 5"):
        found = fits(studio, materials, name, observed, settings)
        photograph = studio.photographs(materials, observed)[name]
        seen = enlarged(sphere_tile(photograph, common_exposure([photograph])), studio.quality.tile)
        given: list[Cell] = [Tile(seen, "photograph"), None]
        weights = [studio.itself(name), *(fit.weights for fit in found)]
        rows: list[Row] = []
        errors = []
        for light in lights:
            images = studio.under(weights, light)
            scale = light.exposure(images[:1])
            row = light.row(light.label(scale).replace(", ", ",\n"), images, images[:1] * len(images), scale)
            rows.append(Row(row.label, [given[len(rows)], *row.cells]))
            errors.append([percent(ball_error(image, images[0])) for image in images[1:]])
        lines = [middle_line(image) for image in images]
        rows.append(Row("middle line,\nreference grey", [None, *(Profile(line, lines[0]) for line in lines)]))
        columns = [_CALLED[setting.name] for setting in settings]
        blocks.append(Block(name, [Light(observed).name, "reference", *columns], rows))
        body.append([name, *(" / ".join(pair) for pair in zip(*errors, strict=True))])
    head = [" / ".join(light.name for light in lights), *(_CALLED[setting.name] for setting in settings)]
    return Sheet(blocks), markdown_table(head, body)


def _residual(studio: Studio, materials: Sequence[str], name: str, probe: tb.LightProbe) -> float:
    """|Y w - y|^2 of the material itself: the noise of its photograph."""
    basis = studio.basis(probe, studio.photographed)
    return float((basis.image(name) - studio.photographs(materials, probe)[name]).double().square().sum())


def fits(
    studio: Studio, materials: Sequence[str], name: str, probe: tb.LightProbe, settings: Sequence[Setting]
) -> list[Fit]:
    """Of one of some materials, by the library and the classes of all others; kept on disk, so that a run can go on."""
    facts = studio.facts(probe=probe.fingerprint, materials=list(materials), settings=[one.name for one in settings])
    parts = tuple(Fit.__annotations__)

    def make() -> dict[str, Tensor]:
        library = without_relatives(studio.library, name)
        photograph = studio.photographs(materials, probe)[name]
        made: dict[str, Tensor] = {}
        for i, setting in enumerate(settings):
            result = studio.estimator(library, probe, setting)(photograph)
            candidates = [studio.weights(one, library.names) for one in result.class_weights]
            weights = studio.weights(result.weights, library.names)
            fit = Fit(weights, torch.stack(candidates), result.class_errors, result.error)
            made |= {f"{i} {part}": getattr(fit, part) for part in parts}
        return made

    path = studio.folder / f"fits-{name}-{probe.fingerprint[:12]}-{len(settings)}.safetensors"
    kept = stored(path, facts, make)
    return [Fit(**{part: kept[f"{i} {part}"] for part in parts}) for i in range(len(settings))]
