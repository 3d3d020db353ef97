"""What BRDFs are judged by, and the files that hold them; without torch, for the command line's help."""

METRIC_NAMES = ("l2", "log", "cube-root")

RGL_SUFFIX = ".bsdf"
"""Of measured materials of the RGL database, in lower case."""

TABLE_SUFFIX = ".binary"
"""Of MERL tables that are written."""
