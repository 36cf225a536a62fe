"""The three ways to measure a machine: on the fly, at standstill, and along lines with a six-dof laser."""
