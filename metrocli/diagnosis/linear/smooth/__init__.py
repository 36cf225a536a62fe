"""Smooth functions of covariates: their columns, and the knots between which they are linear."""
