"""The linearised adjustment and what can be added to it: candidates, their columns and their tests."""
