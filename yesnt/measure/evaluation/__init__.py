"""Measures finished shots that come with truth, and sets the numbers beside the paper's (method.md section 7)."""
