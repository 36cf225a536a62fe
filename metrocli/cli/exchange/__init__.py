"""Commands that take files from other programs."""
