"""Stochastic intrinsic decomposition: diffusion members over patches (method.md section 3)."""
