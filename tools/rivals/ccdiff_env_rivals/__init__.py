"""Weights of CCDiff's rivals: data alone, which `ccdiff_env.models.shipped_weights` finds."""
