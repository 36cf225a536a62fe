"""Commands for the shell in which metrocli runs."""
