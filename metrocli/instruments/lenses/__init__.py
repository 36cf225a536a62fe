"""Lenses: distortion, the link to image points, and the same lens in the words of others."""
