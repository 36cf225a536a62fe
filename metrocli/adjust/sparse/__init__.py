"""Sparse normal equations of blocks that stay coupled: nested dissection, Cholesky factor, selected inverse.

`partition` (net, local unknowns, border) -> `nested_dissection` (order) -> `cholesky` (fronts) ->
`bordered_factor`, which finds the undetermined directions and solves.

Method: docs/algorithms/nested-dissection.md.
"""
