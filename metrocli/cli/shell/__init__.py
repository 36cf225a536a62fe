"""What surrounds every command, and commands for the shell in which metrocli runs."""
