"""Selection: which candidates go into the model, which stay, and which others explain as much.

Method: docs/algorithms/selection-and-levels.md.
"""
