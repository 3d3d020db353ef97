"""Pages on which to judge a BRDF: the report of one reconstruction, and tables side by side.

In: a reconstruction and what it was made from, or tables. Out: one HTML file that opens offline.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
