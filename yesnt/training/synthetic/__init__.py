"""Synthetic scenes for training: shapes, painted materials, soft capture light, and camera degradation."""
