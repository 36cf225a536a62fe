"""Results and projects as self-contained HTML pages."""
