"""What BRDFs are judged by, and the files that hold them; without torch, for the command line's help."""

METRIC_NAMES = ("l2", "log", "cube-root")

RGL_SUFFIX = ".bsdf"
"""Of measured materials of the RGL database, in lower case."""

TABLE_SUFFIX = ".binary"
"""Of MERL tables that are written."""

TABLE_SUFFIXES = (TABLE_SUFFIX, ".fullbin", RGL_SUFFIX)
"""Of measured tables, in lower case; the header of each tells what it is."""

RESULT = "brdf.binary"
"""The table in a folder that `torchbrdf fit` writes."""

RESULT_STD = "brdf_std.binary"
"""The standard deviation of f_r in every cell, as a MERL table, beside it."""

EMBEDDED = "default"
"""Names the embedded library among files."""

AGAIN = "the file is damaged: download or convert it again"
"""What to do, in a message."""
