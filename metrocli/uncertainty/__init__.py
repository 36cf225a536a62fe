"""Uncertainty: models as expressions, their derivatives, GUM and Monte Carlo propagation, and what follows from it."""
