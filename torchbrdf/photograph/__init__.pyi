from .choice import another as another, locate as locate
from .finding import find_balls as find_balls
from .moving import (
    REACH as REACH,
    MovingSilhouette as MovingSilhouette,
)
from .observation import (
    LARGEST_DEFAULT_SIZE as LARGEST_DEFAULT_SIZE,
    Observation as Observation,
    observe as observe,
    observe_view as observe_view,
)
from .photograph import Photograph as Photograph
from .silhouette import (
    Circle as Circle,
    find_ball as find_ball,
    find_circle as find_circle,
)
