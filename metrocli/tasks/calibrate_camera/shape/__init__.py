"""The model spline: the shape of a lens beside its base model."""
