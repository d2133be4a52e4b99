"""Builders of a shot's nodes, one file per stage: which tasks there are, what each needs, and what its key holds."""
