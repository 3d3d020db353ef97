from dataclasses import replace
from html.parser import HTMLParser

import pytest
import torch
from torch import Tensor

from materials import glossy
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import GRID, MerlTable, above_horizon
from torchbrdf.estimation.classes import MaterialClasses, Mixture
from torchbrdf.estimation.image_space import ImageSpace
from torchbrdf.estimation.observability import CANNOT, HARDLY, Observability, observability
from torchbrdf.estimation.priors import PriorBank, prior_variances
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.report._observability_section import heat_map, observability_section
from torchbrdf.view.sphere import SphereView

VIEW = SphereView(16)


def lights() -> dict[str, LightProbe]:
    """Uniform, uniform with a lamp in red only, and torchbrdf's own room."""
    uniform = torch.ones(3, 16, 32)
    red = torch.zeros(3, 16, 32)
    red[0] = 0.2
    red[0, 4, 10] = 50.0
    return {"uniform": LightProbe(uniform), "red": LightProbe(red), "room": LightProbe.default(32)}


@pytest.fixture(scope="module")
def materials() -> MaterialLibrary:
    """Nine plastics of three roughnesses and many albedos: under uniform light roughness hardly shows."""
    tables = []
    for i, alpha in enumerate((0.04, 0.1, 0.25) * 3):
        albedo = tuple(0.1 + 0.7 * ((0.381966 * (3 * i + c)) % 1) for c in range(3))
        name = f"plastic-{i}"
        tables.append(MerlTable.from_function(glossy(albedo, (0.06, 0.05, 0.04), alpha), name))
    return MaterialLibrary.from_tables(tables)


@pytest.fixture(scope="module")
def packed(materials: MaterialLibrary) -> dict[str, Tensor]:
    """Basis images (n, 3, P) under every light."""
    return {name: render_basis(materials, light, VIEW, samples=128).packed for name, light in lights().items()}


@pytest.fixture(scope="module")
def classes(materials: MaterialLibrary) -> MaterialClasses:
    """Materials in turn in two classes."""
    one_hot = torch.nn.functional.one_hot(torch.arange(materials.n) // 3 % 2).double()
    mixture = Mixture(
        one_hot.mean(0), torch.zeros(2, 4).double(), torch.eye(4).double().repeat(2, 1, 1), one_hot, (0.0,), True
    )
    return MaterialClasses(mixture, materials.names, materials.source, materials.gram.diagonal().sqrt())


def bank_of(images: Tensor, classes: MaterialClasses) -> PriorBank:
    """The priors as the estimator makes them."""
    space = ImageSpace.of(images, [images.shape[-1]])
    membership = classes.labels == torch.arange(classes.n_classes)[:, None]
    return PriorBank.of(space, prior_variances(membership, classes.norms, space))


def dense(images: Tensor, variances: Tensor, noise: float) -> list[tuple[Tensor, Tensor, float]]:
    """Of each channel: prior and posterior covariance of the weights and degrees of freedom, by dense algebra."""
    space = ImageSpace.of(images, [images.shape[-1]])
    prior = torch.diag(variances / len(variances))
    found = []
    for r in space.r:
        signal = r @ prior @ r.mT
        floor = noise**2 * signal.trace() / (images.shape[-1] / (1 + 7 * images.shape[-1] / 3080))
        known = torch.linalg.solve(signal + floor * torch.eye(len(r)), r @ prior)
        freedom = torch.linalg.solve(signal + floor * torch.eye(len(r)), signal).trace()
        found.append((prior, prior - prior @ r.mT @ known, float(freedom)))
    return found


def test_freedom_is_the_trace_of_the_smoother(packed, classes):
    found = observability(bank_of(packed["room"], classes), classes, noise=0.02)
    bank = bank_of(packed["room"], classes)
    for j in range(2):
        expected = sum(freedom for _, _, freedom in dense(packed["room"], bank.variances[j], 0.02)) / 3
        assert float(found.freedom[j]) == pytest.approx(expected, rel=1e-6)
    expected = sum(freedom for _, _, freedom in dense(packed["room"], torch.ones(27).double(), 0.02)) / 3
    assert found.whole == pytest.approx(expected, rel=1e-6)
    assert found.freedom.shape == (2,)


def test_seen_is_the_share_of_variance_removed(materials, packed, classes):
    found = observability(bank_of(packed["room"], classes), classes, materials)
    norms = materials.gram.diagonal().sqrt()
    parts = dense(packed["room"], (1 / norms) / (1 / norms).mean(), 0.01)

    def removed(row: Tensor) -> float:
        return sum(1 - float(row @ after @ row) / float(row @ before @ row) for before, after, _ in parts) / 3

    r = ImageSpace.of(packed["room"], [packed["room"].shape[-1]]).r
    expected = 0.0
    for (before, after, _), channel in zip(parts, r, strict=True):
        brightness = channel.mT @ channel.mean(1)
        row = norms - brightness * (norms @ before @ brightness) / (brightness @ before @ brightness)
        assert abs(float(row @ before @ brightness)) < 1e-6 * float(norms @ before @ brightness)
        expected += (1 - float(row @ after @ row) / float(row @ before @ row)) / 3
    assert found.highlight == pytest.approx(expected, rel=1e-5)
    lit = above_horizon()
    for i, j in ((0, 0), (0, 9), (7, 3), (17, 1)):
        h, d = 2 + 5 * i, 2 + 5 * j
        assert lit[h, d, 90]
        row = materials.rows(torch.tensor([(h * GRID[1] + d) * GRID[2] + 90]))[0].double()
        assert float(found.seen[i, j]) == pytest.approx(removed(row), rel=1e-5)
        assert float(found.theta_d[j]) == pytest.approx(d + 0.5)
        assert float(found.theta_h[i]) == pytest.approx(((h + 0.5) / 90) ** 2 * 90)
    below = ~lit[2::5, 2::5, 90]
    assert below.any()
    assert found.seen[below].isnan().all()
    assert ((found.seen[~below] >= 0) & (found.seen[~below] <= 1)).all()


def test_uniform_light_cannot_tell_gloss_from_albedo_and_a_room_can(materials, packed, classes):
    # few materials differ less than a whole library, so the noise is more than that of the default
    uniform = observability(bank_of(packed["uniform"], classes), classes, materials, noise=0.025)
    room = observability(bank_of(packed["room"], classes), classes, materials, noise=0.025)
    assert uniform.highlight < CANNOT < HARDLY < room.highlight
    assert uniform.verdict.startswith("cannot tell gloss from albedo")
    assert room.verdict.startswith("tells gloss from albedo")
    assert uniform.whole < room.whole
    assert (uniform.freedom < room.freedom).all()
    peak, dull = slice(0, 2), slice(8, 12)
    assert 1 - uniform.seen[peak, :6].mean() > 3 * (1 - room.seen[peak, :6].mean())
    assert uniform.seen[dull, :6].nanmean() > 0.5


@pytest.mark.parametrize(
    ("highlight", "start"),
    [
        (0.1, "cannot tell"), (CANNOT, "hardly tells"), (0.39, "hardly tells"), (0.44, "partly tells"),
        (HARDLY, "partly tells"), (0.49, "partly tells"), (0.51, "tells"), (0.9, "tells"),
    ],
)
def test_verdicts(packed, classes, highlight, start):
    found = observability(bank_of(packed["room"], classes), classes)
    line = replace(found, highlight=highlight).verdict
    assert line.startswith(f"{start} gloss from albedo: removes {highlight:.0%} of what is open about the highlight")
    assert "\n" not in line
    assert f"about {found.whole:.0f} numbers a channel stand out of 1.0% noise" in line


def test_what_one_side_does_not_show_is_a_guess_from_there_alone(packed, classes):
    """A second photograph, with the camera gone round, may show it."""
    found = observability(bank_of(packed["room"], classes), classes)
    said = replace(found, seen=torch.zeros(18, 18)).verdict
    assert "no light from behind the object: grazing reflection will be a guess from this side alone; removes" in said


def test_shadow_is_said(packed, classes):
    images = packed["room"].clone()
    p = images.shape[-1]
    images[..., : p // 2] = 0
    for images_of_two in (images, torch.cat([images, images * 1e-3], -1)):  # two exposures have two levels
        space = ImageSpace.of(images_of_two, [p] * (images_of_two.shape[-1] // p))
        found = observability(PriorBank.of(space, bank_of(images, classes).variances), classes)
        assert found.dark == pytest.approx((p // 2) / p)
        assert "50% of the picture lies in shadow" in found.verdict
        assert found.verdict.startswith("tells gloss from albedo where light falls: ")
    lit = observability(bank_of(packed["room"], classes), classes)
    assert lit.dark == 0
    assert "shadow" not in lit.verdict


def test_less_noise_tells_more(packed, classes):
    bank = bank_of(packed["room"], classes)
    fine, coarse = (observability(bank, classes, noise=noise) for noise in (0.001, 0.1))
    assert fine.whole > coarse.whole
    assert fine.highlight > coarse.highlight
    assert (fine.freedom > coarse.freedom).all()


def test_the_brightness_of_the_light_does_not_matter(packed, classes):
    one = observability(bank_of(packed["room"], classes), classes)
    for factor in (2.0**-20, 2.0**20):
        scaled = observability(bank_of(packed["room"] * factor, classes), classes)
        assert scaled.whole == pytest.approx(one.whole, rel=1e-9)
        assert scaled.highlight == pytest.approx(one.highlight, rel=1e-9)


def test_channels_without_light_do_not_count(packed, classes):
    red = observability(bank_of(packed["red"], classes), classes)
    coloured = packed["red"].clone()
    coloured[:, 1:] = coloured[:, :1]
    white = observability(bank_of(coloured, classes), classes)
    assert red.whole == pytest.approx(white.whole, rel=1e-6)
    assert red.highlight == pytest.approx(white.highlight, rel=1e-6)


def test_no_light_tells_nothing(materials, packed, classes):
    dark = observability(bank_of(packed["room"] * 0, classes), classes, materials)
    assert dark.whole == dark.highlight == 0
    assert dark.verdict == "no light on the object: tells nothing"
    assert (dark.seen[~dark.seen.isnan()] == 0).all()


def test_bad_input(materials, packed, classes):
    bank = bank_of(packed["room"], classes)
    for noise in (0.0, -1.0, float("nan"), float("inf")):
        message = f"noise must be above 0, a share of the photograph such as 0.01, got {noise}"
        with pytest.raises(ValueError, match=message):
            observability(bank, classes, noise=noise)
    with pytest.raises(ValueError, match="this library is not the one that the basis images were rendered with"):
        observability(bank, classes, materials.subset(materials.names[:8]))


class Tags(HTMLParser):
    """Start tags and text; every tag must be closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def example(seen: Tensor | None) -> Observability:
    """Numbers that are easy to find again."""
    angles = torch.linspace(1, 88, 18)
    return Observability(0.01, torch.tensor([3.25, 7.75]), 12.5, 0.1, 0.0, seen, angles, angles)


def test_section_shows_verdict_freedom_and_every_cell():
    seen = torch.full((18, 18), 0.5)
    seen[0, 0], seen[17, 17], seen[3, 4] = 0.0, torch.nan, 1.0
    page = Tags(observability_section(example(seen)))
    assert example(seen).verdict in page.text
    for text in ("What this light can tell", "class 1", "3.2", "7.8", "12.5"):
        assert text in page.text
    cells = [attrs["fill"] for tag, attrs in page.found if tag == "rect"][: 18 * 18]
    assert cells[0] == "#26263c"
    assert cells[3 * 18 + 4] == "#fad65c"
    assert cells[-1] == "#d4d4d4"
    assert len({*cells}) == 4
    places = {(attrs["x"], attrs["y"]) for tag, attrs in page.found if tag == "rect"}
    assert len(places) == 18 * 18 + 11


def test_section_without_cells():
    page = Tags(observability_section(example(None)))
    assert not any(tag == "svg" for tag, _ in page.found)
    assert "12.5" in page.text
    with pytest.raises(ValueError, match=r"no cells to draw; ask for the observability with library=..."):
        heat_map(example(None))
