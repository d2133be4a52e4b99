"""Launchers: each starts the workers of a run in one kind of place. `table.py` lists them."""
