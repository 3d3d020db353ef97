"""BRDFs side by side: their pictures under a probe, their albedo, and how far each is from the first."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isinf

import torch
from torch import Tensor

from torchbrdf.brdf import BRDFDifference, MerlTable, directional_albedo, reflects_too_much
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, converted, exposure_for
from torchbrdf.light import LightProbe
from torchbrdf.rendering import render_tables
from torchbrdf.report._pictures import short_name
from torchbrdf.report.settings import COMPARISON_SAMPLES, COMPARISON_SIZE
from torchbrdf.view import SphereView

_FEW_COMMON = 0.99
"""Share of the cells below which the page says that the differences do not count all of them."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Tables side by side; the first is the reference.

    shown        the tables under white light as a screen shows them: R, G, B of Rec. 709, as in all pictures
    probe        the light, for its picture
    pictures     (K, 3, N, N)  radiance of spheres under it
    exposure     takes the 99th percentile of the reference's picture to white
    albedo       (K, 4)        directional albedo at `ALBEDO_DEG`, mean of R, G, B
    differences  of all but the first from the first
    """

    names: Sequence[str]
    tables: Sequence[MerlTable]
    shown: Sequence[MerlTable]
    probe: LightProbe
    pictures: Tensor
    exposure: float
    albedo: Tensor
    differences: Sequence[BRDFDifference]

    @classmethod
    def of(
        cls,
        tables: Sequence[MerlTable],
        probe: LightProbe,
        names: Sequence[str] | None = None,
        *,
        size: int = COMPARISON_SIZE,
        samples: int = COMPARISON_SAMPLES,
        primaries: ColourSpace = DEFAULT_SPACE,
    ) -> "Comparison":
        """Render and measure.

        names    of the tables; default: their own
        size     pixels along a side of the spheres
        samples  light samples a pixel, the same for all tables
        primaries  the linear RGB of tables and light
        Raises ValueError for fewer than two tables, and where a table cannot be shown or compared.
        """
        tables = [MerlTable(table.values.detach().cpu(), table.valid.cpu(), table.name) for table in tables]
        names = [table.name for table in tables] if names is None else list(names)
        if len(tables) < 2 or len(names) != len(tables):
            raise ValueError(
                f"a comparison needs two tables or more, each with a name, got {len(tables)} with {len(names)} names"
            )
        if not bool((tables[0].values[tables[0].valid] > 0).any()):
            raise ValueError(f"{names[0]}: nothing differs relatively from a BRDF of 0; name another table first")
        for name, table in zip(names[1:], tables[1:], strict=True):
            if not bool((table.valid & tables[0].valid).any()):
                raise ValueError(f"{name}: no cell was measured both here and in {names[0]}: nothing can be compared")
        view = SphereView(size)
        pictures = render_tables(tables, probe, view, samples).cpu()
        shown = tables
        if primaries != DEFAULT_SPACE:
            pictures = converted(pictures.transpose(0, 1), primaries, DEFAULT_SPACE).transpose(0, 1)
            shown = [
                MerlTable(converted(table.values.T, primaries, DEFAULT_SPACE).T.clamp_min(0), table.valid, table.name)
                for table in tables
            ]
            probe = LightProbe(converted(probe.radiance, primaries, DEFAULT_SPACE).clamp_min(0), name=probe.name)
        exposure = exposure_for(pictures[0], view.mask)
        differences = [
            BRDFDifference.of(table, tables[0], (image, pictures[0]), view.mask, exposure)
            for table, image in zip(tables[1:], pictures[1:], strict=True)
        ]
        albedo = torch.stack([directional_albedo(table).mean(1) for table in tables])
        return cls(names, tables, shown, probe, pictures, exposure, albedo, differences)

    @property
    def warnings(self) -> list[str]:
        """What a reader should know before believing the page: holes, black, more light than there was."""
        found = []
        for name, table, albedo in zip(self.names, self.tables, self.albedo, strict=True):
            holes = 1 - table.measured_share
            if holes > 0:
                found.append(
                    f"{name}: {percentage(holes)} of its cells above the horizon were not measured; the pictures show "
                    "their nearest measured neighbours there."
                )
            if not bool((table.values[table.valid] > 0).any()):
                found.append(f"{name}: 0 in every measured cell.")
            if (too_much := reflects_too_much(albedo)) is not None:
                found.append(f"{name}: {too_much}.")
        for name, difference in zip(self.names[1:], self.differences, strict=True):
            if difference.common < _FEW_COMMON:
                found.append(
                    f"{name} and {self.names[0]}: {percentage(difference.common)} of the cells were measured in both; "
                    "the differences over cells count no others."
                )
        if any(isinf(difference.picture) for difference in self.differences):
            found.append(f"{self.names[0]} is black under {short_name(self.probe)}: no relative difference exists.")
        return found


def percentage(value: float) -> str:
    """A share in per cent that is 0 or 100 only where it is exactly that."""
    if 0 < value < 0.001:
        return "less than 0.1%"
    if 0.999 < value < 1:
        return "more than 99.9%"
    return f"{value:.1%}"
