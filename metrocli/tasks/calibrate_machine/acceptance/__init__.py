"""Acceptance figures of machine tools, by standard.

- ISO 230-2: `runs` (from the readings or the tables) -> `positioning` (figures of a line with their uncertainty)
- ISO 230-4 and ISO 230-6: `contours` (circles and body diagonals that the error tables predict)
- ISO 230-7: `rotary_axes` (error motion, and where two rotary axes pass each other)
- kinematic tests: `paths` (range of the tip against the workpiece)
- `ranges`: the U of ranges, for circles, diagonals, motions and paths
"""
