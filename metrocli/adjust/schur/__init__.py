"""Elimination of point-like blocks, tile by tile, and the covariance of their members."""
