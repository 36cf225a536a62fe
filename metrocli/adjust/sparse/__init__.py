"""Sparse normal equations of blocks that stay coupled: nested dissection, Cholesky, selected inverse."""
