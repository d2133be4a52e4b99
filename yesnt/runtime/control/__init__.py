"""Submits runs and looks after them from outside."""
