"""Tables I to III of [CBP21], to stand beside ours in scripts/paper/rotation/report.py."""

CLASS_NAMES = ("Diffuse", "Plastics & phenolics", "Specular paints & plastics", "Metals")
"""Our classes 0 to 3 (docs/results/classes.md) by the names of [CBP21, sec. IV]."""

LAYOUT = (0, 1, 3, 2)
"""The order of the columns in [CBP21, tables I and II]."""

PAPER_1 = {
    ("eucalyptus", 1): (0.42, 1.93, 3.33, 0.42), ("eucalyptus", 2): (1.67, 9.43, 10.69, 8.61),
    ("eucalyptus", 5): (10.76, 82.27, 73.18, 116.92), ("eucalyptus", 10): (46.55, 180.75, 121.30, 250.17),
    ("grace", 1): (2.11, 3.17, 2.18, 0.99), ("grace", 2): (8.44, 13.48, 9.93, 6.33),
    ("grace", 5): (51.73, 78.53, 47.57, 58.38), ("grace", 10): (203.12, 200.82, 255.99, 226.35),
    ("galileo", 1): (17.84, 12.28, 7.75, 8.78), ("galileo", 2): (72.90, 47.85, 51.76, 71.53),
    ("galileo", 5): (504.72, 335.09, 419.84, 899.47), ("galileo", 10): (2358.62, 1012.95, 508.79, 1678.51),
    ("uffizi", 1): (0.25, 0.73, 2.39, 0.29), ("uffizi", 2): (1.02, 1.91, 4.16, 1.00),
    ("uffizi", 5): (6.58, 8.88, 5.12, 10.08), ("uffizi", 10): (28.70, 39.67, 15.35, 67.98),
}  # fmt: skip
"""Table I, by light probe and degrees: classes in the order of LAYOUT."""

PAPER_2 = {
    45: (30.00, 4.41, 1.37, 2.57, 4), 90: (23.09, 6.65, 1.47, 11.08, 7.75), 135: (47.33, 14.42, 1.36, 15.61, 13),
    180: (49.04, 12.64, 2.24, 6.92, 10.25), 225: (13.27, 4.90, 1.31, 2.22, 7.75), 270: (8.17, 4.61, 2.32, 1.17, 9.5),
    315: (5.71, 3.23, 1.60, 1.37, 4.24),
}  # fmt: skip
"""Table II, by degrees: classes in the order of LAYOUT, then the percentage of changed classes."""

PAPER_3 = {
    2: (55.50, 44.50), 3: (46.75, 45.25, 8.00), 4: (48.25, 44.25, 5.50, 2.00), 5: (48.75, 37.25, 9.25, 4.75, 0.00),
    6: (50.50, 42.00, 3.75, 3.50, 0.25, 0.00), 7: (49.75, 45.25, 4.00, 0.50, 0.50, 0.00, 0.00),
}  # fmt: skip
"""Table III, by K: percentages of the reconstructions."""
