"""Rotations, poses and shapes: pure functions on arrays, all broadcasting over leading axes.

`rotations` -> `poses`; `surfaces` (planes, cylinders, cones, spheres) and `triangles` -> `nearest_triangles` for a
part.
"""
