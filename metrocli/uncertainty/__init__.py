"""Uncertainty: models as expressions, their derivatives, GUM and Monte Carlo propagation, validation and decisions."""
