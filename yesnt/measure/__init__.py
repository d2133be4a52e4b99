"""Measures the product: evaluation against truth, and the trade of speed for accuracy."""
