"""Acceptance figures of machine tools, by standard."""
