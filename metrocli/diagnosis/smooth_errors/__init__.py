"""Smooth random errors: raced as processes against names, and counted as noise where they win."""
