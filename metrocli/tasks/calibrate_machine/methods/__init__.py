"""The ways to measure a machine: on the fly, at standstill, along lines with a six-dof laser, and from lengths.

Each builds the groups of its readings for the problem of the machine:

- `on_the_fly`, whose stream `track` lays onto its path; `standstill`; `lengths`
- `six_dof`: along `lines`, or about rotary axes (`turned_lines` checks their angles)
- `probing`: balls on the workpiece that a probe finds
- rotary axes in any pose: `poses` has the problem of a table, with errors that `known_axes` gives, and what a machine
  without errors reads; `simulated_poses` reads it with true ones

`targets` are what the readings see: tools, reflectors and balls.
"""
