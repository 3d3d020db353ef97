"""The pieces of the paper's experiments, which the scripts above run: its figures, tables I to III, leave-one-out."""
