"""Instruments: links, chains and starting values, one file each."""
