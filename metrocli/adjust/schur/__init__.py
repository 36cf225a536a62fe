"""Elimination of a block of points (or other members that readings use one at a time), and its covariance.

`layout` (which block) -> `tiles` (members read alike) -> `tile_rows` (derivatives) -> `tiled_elimination` by
`batched_cholesky` -> `normals`, which adds `irregular_normals` and solves; then `member_covariance` and
`covariance`.

Method: docs/algorithms/tiled-elimination.md.
"""
