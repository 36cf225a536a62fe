"""Hidden effects: measurements simulated by plain formulas, with something in them that `diagnose` must find or not."""
