"""Tables under a light [CBP21, eq. 1]."""

from collections.abc import Sequence

import torch
from torch import Tensor

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
    Runs on the device of the probe, as `render_basis` does but in float32.
    """
    if samples is None and unsuited(view) is None:
        return table_pictures(table, [(probe, None)], view)[0].clamp_min(0)  # ringing about a lamp in the dark
    return render_tables([table], probe, view, DEFAULT_SAMPLES if samples is None else samples, seed)[0]


def render_tables(
    tables: Sequence[MerlTable], probe: LightProbe, view: View, samples: int = DEFAULT_SAMPLES, seed: int = 0
) -> Tensor:
    """Radiance (K, 3, H, W) of several tables by one set of samples, which cost more than the lookups."""
    values = torch.cat([table.filled.to(probe.device, torch.float32) for table in tables], dim=1)
    packed = render_columns(values, probe, view, samples, seed).unflatten(2, (len(tables), 3))
    return view.unpack(torch.einsum("cpkc->kcp", packed))
