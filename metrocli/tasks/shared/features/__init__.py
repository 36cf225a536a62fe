"""Ideal features through points, for multilaterate and fit-points: least squares and minimum zone, with uncertainty."""
