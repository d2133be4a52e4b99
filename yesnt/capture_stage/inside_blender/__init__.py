"""Scripts that run in Blender's Python; they import `bpy` and nothing of yesnt."""
