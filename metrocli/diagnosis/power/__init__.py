"""The sizes that tests find, and the candidates that they cannot tell apart.

`average_power` has the size that a test finds in so many cases, over all directions of an effect; `collinear` the
pairs of candidates whose visible signatures are nearly one, with what would separate them.
"""
