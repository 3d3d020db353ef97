from ._catalogue import (
    exif_of as exif_of,
    read_stored as read_stored,
)
from ._quiet import quiet_decoders as quiet_decoders
from ._stored import (
    Stored as Stored,
    Window as Window,
)
from .openexr import read_headers as read_headers
