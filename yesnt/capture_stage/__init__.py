"""The virtual capture stage: subjects whose true materials, motion and relit pictures are known (issue 3).

Host side only. `inside_blender` and `inside_anny` hold scripts for other Pythons, started as subprocesses.
"""
