"""The model of an adjustment: quantities, blocks, chains of links, observations, and groups of these."""
