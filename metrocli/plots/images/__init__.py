"""Figures over an image: residual vectors, and how readings cover it."""
