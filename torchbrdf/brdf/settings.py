"""What BRDFs are judged by; without torch, for the command line's help."""

METRIC_NAMES = ("l2", "log", "cube-root")
