"""Tables under a light [CBP21, eq. 1]."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchbrdf.arguments import check_types, warn_of_lost_gradient
from torchbrdf.brdf import MerlTable
from torchbrdf.light import LightProbe
from torchbrdf.transport import DEFAULT_SAMPLES, render_columns
from torchbrdf.transport.harmonic import table_pictures, unsuited
from torchbrdf.view import View


def render(
    table: MerlTable, probe: LightProbe, view: View, samples: int | None = None, seed: int = 0
) -> Tensor:
    """Radiance (3, H, W) of a view whose material is `table`, 0 outside the mask.

    samples  a pixel, on average, of the sampled transport. None: no sampling but the harmonic transport of the table,
             within 0.5 % of converged; where the view does not allow that, as `render_basis` has it, 4096
    Runs on the device of the probe, as `render_basis` does but in float32. The harmonic transport is differentiable in
    the probe's radiance, the sampled one in the table's values; each warns where the other requires a gradient. Raises
    ValueError for arguments of other types.
    """
    check_types("tb.render", table=(table, MerlTable), probe=(probe, LightProbe), view=(view, View))
    if samples is None and unsuited(view) is None:
        instead = "samples=4096 carries it, with noise; for weights use basis.render(weights)"
        warn_of_lost_gradient(table.values, "the table's values by the harmonic transport", instead)
        return table_pictures(table, [(probe, None)], view)[0].clamp_min(0)  # ringing about a lamp in the dark
    return render_tables([table], probe, view, DEFAULT_SAMPLES if samples is None else samples, seed)[0]


def render_tables(
    tables: Sequence[MerlTable], probe: LightProbe, view: View, samples: int = DEFAULT_SAMPLES, seed: int = 0
) -> Tensor:
    """Radiance (K, 3, H, W) of several tables by one set of samples, which cost more than the lookups.

    Differentiable in the tables' values, not in the probe's radiance, see `render`. Raises ValueError for no table, or
    samples that are fewer than 2 or no whole number.
    """
    if not tables:
        raise ValueError("render_tables needs at least one table, got none")
    instead = "tb.render without samples carries it, of a view that the harmonic transport takes"
    warn_of_lost_gradient(probe.radiance, "the probe's radiance by the sampled transport", instead)
    values = torch.cat([table.filled.to(probe.device, torch.float32) for table in tables], dim=1)
    packed = render_columns(values, probe, view, samples, seed).unflatten(2, (len(tables), 3))
    return view.unpack(torch.einsum("cpkc->kcp", packed))
