"""Elimination of a block of points (or other members that readings use one at a time), and its covariance.

Method: docs/algorithms/tiled-elimination.md.
"""
