"""Tables under a light [CBP21, eq. 1]."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchbrdf.brdf import MerlTable
from torchbrdf.light import LightProbe
from torchbrdf.transport import DEFAULT_SAMPLES, render_columns
from torchbrdf.view import View


def render(
    table: MerlTable, probe: LightProbe, view: View, samples: int = DEFAULT_SAMPLES, seed: int = 0
) -> Tensor:
    """Radiance (3, H, W) of a view whose material is `table`, 0 outside the mask.

    Runs on the device of the probe, as `render_basis` does but in float32.
    """
    return render_tables([table], probe, view, samples, seed)[0]


def render_tables(
    tables: Sequence[MerlTable], probe: LightProbe, view: View, samples: int = DEFAULT_SAMPLES, seed: int = 0
) -> Tensor:
    """Radiance (K, 3, H, W): `render` of several tables with one set of samples, which cost more than the lookups."""
    values = torch.cat([table.filled.to(probe.device, torch.float32) for table in tables], dim=1)
    packed = render_columns(values, probe, view, samples, seed).unflatten(2, (len(tables), 3))
    return view.unpack(torch.einsum("cpkc->kcp", packed))
