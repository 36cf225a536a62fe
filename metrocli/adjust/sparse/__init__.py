"""Sparse normal equations of blocks that stay coupled: nested dissection, Cholesky factor, selected inverse.

Method: docs/algorithms/nested-dissection.md.
"""
