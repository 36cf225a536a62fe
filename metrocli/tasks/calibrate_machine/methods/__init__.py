"""The ways to measure a machine: on the fly, at standstill, along lines with a six-dof laser, and from lengths.

Each builds the groups of its readings for the problem of the machine; `track` lays a stream onto its path for
`on_the_fly`, `backwards` finds axes that count the other way in lengths.
"""
