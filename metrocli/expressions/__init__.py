"""Expressions that a user writes: parsed without being executed, their units checked, with exact derivatives."""
