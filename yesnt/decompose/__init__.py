"""Stochastic intrinsic decomposition: roughness and metallic with their uncertainty (docs/method.md section 3)."""
