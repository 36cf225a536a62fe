"""Links of effects; each module holds one family."""
