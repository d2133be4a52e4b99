"""Measures shots that have ground truth and compares the results with the paper's (method.md section 7)."""
