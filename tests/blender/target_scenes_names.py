"""The scenes of `target_scenes.py` that the built-in set shows too; plain data for Blender's Python and for ours."""

GROUNDS: dict[str, tuple[str, tuple[float, float, float], float, float]] = {
    "overcast_ground": ("overcast", (0.5, 0.5, 0.5), 0.9, 0.0),
    "sunny_ground": ("sunny", (0.45, 0.38, 0.3), 0.8, 0.0),
    "glossy_ground": ("studio", (0.25, 0.3, 0.4), 0.25, 0.0),
    "mirror_floor": ("studio", (0.9, 0.9, 0.9), 0.02, 1.0),
}
"""Map, base colour, roughness and metallic of the plane."""
