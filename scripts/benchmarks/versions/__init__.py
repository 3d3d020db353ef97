"""What `compare_versions.py` lets each version do, and how it writes down what came of it."""
