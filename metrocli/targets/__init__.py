"""Targets: from grey values to image coordinates with their standard deviations.

`find` (table of types) -> candidates by `blobs` -> `ellipses` (dots) or `saddles` (corners) -> `lattice` (order of
a board) or `codes` (ring codes) -> names of `pattern`. `render` and `drawings` make images for simulation.

Method: docs/algorithms/target-detection.md.
"""
