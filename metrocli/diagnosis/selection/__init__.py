"""Selection: which candidates enter the model, which stay in it, and which others explain the readings as well.

Method: docs/algorithms/selection-and-levels.md.
"""
