"""Scripts beside the EXR sequence that put its layers together again in Nuke and in Blender."""
