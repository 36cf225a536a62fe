"""What surrounds every command."""
