"""Checks of a job and its inputs before any work."""
