"""Instruments: links, chains and starting values, one file each.

`frames` has the links that all share. A file NAME has the forward model; NAME_start, `linear_maps` and
`track_alignment` find starting values from the readings alone.
"""
