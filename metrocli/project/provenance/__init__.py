"""Where results come from, what changed, and the same again."""
