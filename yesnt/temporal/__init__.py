"""Flow, energy and solver: materials that are stable in time (method.md section 4)."""
