"""Light from all directions: `LightProbe`, linear radiance in lat-long [CBP21, sec. IV].

In: pictures of light in any layout, or a model of a sky or a room. Out: radiance, its integrals, samples of it, and the
probe turned, blurred, scaled or resized.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
