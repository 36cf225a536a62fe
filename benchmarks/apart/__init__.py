"""Measurements of the samples and their adjustment apart from the program: plain formulas, numpy and scipy."""
