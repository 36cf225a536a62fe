"""The model of an adjustment: quantities, blocks, chains of links, observations, and groups of these.

A group is a chain with its observations: `chain` predicts readings from the values of `blocks` and differentiates
them, `observations` has readings, noise and the members that each reading uses, `groups` has the whitened rows of
both.
"""
