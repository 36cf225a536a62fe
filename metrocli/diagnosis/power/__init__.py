"""The sizes that tests find, and the candidates that they cannot tell apart."""
