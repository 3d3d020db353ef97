"""The estimator in learning pipelines: reflectance maps to train on, and what spoils photographs, as augmentations.

In: basis images, or batches `(B, 3, H, W)` of linear radiance with masks. Out: the same, drawn at random; they compose
in `kornia.augmentation.AugmentationSequential`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
