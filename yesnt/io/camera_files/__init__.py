"""Cameras of other programs: Nuke's .chan, USD, Alembic, and a script that exports Blender's."""
