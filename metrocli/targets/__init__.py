"""Targets: from grey values to image coordinates with their standard deviations.

`find` (table of types) calls the module of the type of a `pattern`, which has the names and places of its points:

- `dot`, `circles`, `coded_rings`: candidates by `blobs` -> `ellipses` (centres) -> codes, or the order by `lattice`
- `chessboard`, `charuco`, `aprilgrid`: corners by OpenCV, or predicted by `homography` -> `saddles` (corners from grey
  values) -> `lattice` (checks their order)
- `likely_board`: what images show in which the pattern is not found
- `render` and `drawings` make images for simulation

Method: docs/algorithms/target-detection.md.
"""
