"""Rotations, poses and shapes: pure functions on arrays, all broadcasting over leading axes."""
