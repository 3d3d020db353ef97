from .basis import render_basis as render_basis
from .directional import render_directional as render_directional
from .tables import (
    render as render,
    render_tables as render_tables,
)
