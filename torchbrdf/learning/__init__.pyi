from .augment import (
    RandomExposure as RandomExposure,
    RandomFlicker as RandomFlicker,
    RandomSensorNoise as RandomSensorNoise,
    flicker as flicker,
    photograph_defects as photograph_defects,
    sensor_noise as sensor_noise,
)
from .hiding import (
    RandomDropout as RandomDropout,
    RandomReflection as RandomReflection,
    RandomSaturation as RandomSaturation,
    RandomSilhouetteErosion as RandomSilhouetteErosion,
    RandomStand as RandomStand,
)
from .masking import (
    erode_silhouette as erode_silhouette,
    mask_reflection as mask_reflection,
    mask_saturated as mask_saturated,
    mask_stand as mask_stand,
)
from .occluders import (
    RandomOccluders as RandomOccluders,
    draw_occluders as draw_occluders,
    pixel_grid as pixel_grid,
)
from .probe_rotation import (
    RandomProbeRotation as RandomProbeRotation,
    random_rotations as random_rotations,
    rotate_probes as rotate_probes,
)
from .reflectance_maps import (
    Blending as Blending,
    ReflectanceMaps as ReflectanceMaps,
)
