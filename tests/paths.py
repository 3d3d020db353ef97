"""Where the tests look for what is not installed."""

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""Of the repository."""
