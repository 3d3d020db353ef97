from ._catalogue import layout_of as layout_of
