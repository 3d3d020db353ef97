"""Mitsuba 3, loaded so that it works or says in one sentence why not.

In: nothing but what is installed. Out: the `mitsuba` module in a variant that can be evaluated, or
`MitsubaUnavailableError`. It is imported when something first needs it, and only by way of here.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
