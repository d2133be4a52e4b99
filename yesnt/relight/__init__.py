"""Physically based relighting under an environment map (method.md section 5)."""
