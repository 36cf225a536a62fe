"""What a measurement of a machine determines, and in words what it leaves open."""
