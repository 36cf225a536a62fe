"""Where results come from, what changed, and the same again.

`lineage` follows the digests of inputs back to the measurements; `comparison` holds results beside each other.
"""
