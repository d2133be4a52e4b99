"""The subject in a scene of Blender: plates with and without it, depth, the environment map at its place.

Blender runs as a process of its own (`inside_blender/`); docs/set.md says what a user sees of it.
"""
