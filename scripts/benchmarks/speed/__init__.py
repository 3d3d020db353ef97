"""What `commands.py`, `calls.py` and `growth.py` share: checkouts and their processes, inputs, references, tables."""
