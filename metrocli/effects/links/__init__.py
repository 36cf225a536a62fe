"""Links of effects, one file a family."""
