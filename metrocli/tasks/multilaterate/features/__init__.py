"""Ideal features through corrected points: least squares and minimum zone, with uncertainty."""
