"""Materials measured by the cameras of a capture: likelihood on a grid, pooling, posterior (docs/method.md section 3b).

Pure functions of arrays. `frame.py` is the sequence of steps; `reference.py` states the equations in plain NumPy.
"""
