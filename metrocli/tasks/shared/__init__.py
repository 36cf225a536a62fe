"""What at least two kinds of job use, by its subject."""
