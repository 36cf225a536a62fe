"""Commands about where results come from."""
