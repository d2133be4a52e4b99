"""Measurements: evaluation against ground truth, and speed against accuracy."""
