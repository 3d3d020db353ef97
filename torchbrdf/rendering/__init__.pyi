from .basis import render_basis as render_basis
from .directional import (
    directional_pictures as directional_pictures,
    render_directional as render_directional,
)
from .tables import (
    render as render,
    render_tables as render_tables,
)
