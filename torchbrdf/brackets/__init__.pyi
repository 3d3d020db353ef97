from .bracket import (
    Merged as Merged,
    merge as merge,
)
from .settings import Response as Response
