"""The same work by metrocli and by another program, each in a process of its own.

A module is a piece of work. Its functions take a size, prepare, and return what is timed: a call whose value is a list
of pairs, a number and its standard uncertainty (0 where it has none), which every program gives in the same order.
`benchmarks/peers.py` lists the pairs and runs them; `work.py` runs one function and prints what it took.
"""
