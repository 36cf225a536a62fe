"""What at least two kinds of job share, one module for each subject."""
