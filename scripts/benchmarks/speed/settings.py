"""Names and sizes of the inputs; imports nothing, for processes of any version."""

SIZE = 64
"""Pixels across a photograph."""

TABLES = {"matte": "pink-felt", "glossy": "red-metallic-paint", "mirror-like": "chrome"}
"""Materials of the embedded library whose tables are rendered."""

PROBES = ("default", "smooth", "lamps", "grace")
"""The built-in light; a sky without its sun; small lamps in a dim room; Grace cathedral, where its file is there."""

RENDERED_UNDER = ("smooth", "lamps")

HALF_AROUND = (-1.0, 1.0, -1.0)
"""Diagonal of the rotation to the light under which errors are judged."""
