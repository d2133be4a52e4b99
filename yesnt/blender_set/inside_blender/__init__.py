"""Scripts that run in Blender's own Python: they import nothing of the package."""
