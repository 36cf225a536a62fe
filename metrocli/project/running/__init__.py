"""Who computes the jobs of a run, and what keeps runs apart."""
