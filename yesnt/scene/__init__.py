"""Puts the relit subject into the target scene (method.md section 6)."""
