"""The ways to measure a machine: on the fly, at standstill, six degrees of freedom along lines."""
