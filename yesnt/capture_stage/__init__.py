"""The virtual capture stage: subjects rendered in Blender with true materials, motion and relit images.

Host side only. `inside_blender` and `inside_anny` hold scripts for other Pythons, started as subprocesses.
"""
