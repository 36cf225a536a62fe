"""User-defined effects: definitions in a job or file, read and tested as they become entries of a table."""
