"""Projects that are changed, damaged, killed, starved, spread over a cluster, and left alone."""
