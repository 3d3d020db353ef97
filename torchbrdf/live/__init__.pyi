from .relighting import Relighter as Relighter
from .server import (
    LiveServer as LiveServer,
    listen as listen,
)
