"""Files and processes: EXR, frame store, records, captures, Blender."""
