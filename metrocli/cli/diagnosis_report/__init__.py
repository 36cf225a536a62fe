"""The report of a diagnosis, in text."""
