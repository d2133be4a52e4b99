"""Gaussian opacity fields: the field, its rasteriser with gradients, losses and the fit (docs/method.md section 2)."""
