"""What a user chooses of an analytic fit, with its defaults; without torch, for the command line's help."""

DEFAULT_MODEL, DEFAULT_METRIC = "ggx", "cube-root"

IMAGE_METRIC = "image"
"""The metric that fits with each of METRICS and keeps what renders most like the table, after [BP20]."""

MOST_EVALUATIONS, MOST_ON_A_PHOTOGRAPH = 200, 100
