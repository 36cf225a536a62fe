"""Covariance of an adjustment whose readings share errors within clusters, such as the readings of one image.

`rows` (whitened rows of each cluster) -> `spread` (what a cluster changes) -> `likelihood` (how large errors are
expected) -> `sample` (shrinkage) -> `robust`, which replaces the covariance of a solution.

Method: docs/algorithms/cluster-robust-covariance.md.
"""
