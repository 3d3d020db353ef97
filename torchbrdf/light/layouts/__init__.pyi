from ._catalogue import layout_of as layout_of
from ._disc import DiscLayout as DiscLayout
