"""Covariance of an adjustment whose readings share errors within clusters, such as the readings of one image.

Method: docs/algorithms/cluster-robust-covariance.md.
"""
