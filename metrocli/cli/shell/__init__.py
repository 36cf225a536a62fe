"""What surrounds every command, and commands for the shell in which metrocli runs.

- before a command: `streams` (that are closed or full), `signals` (that end it), `idle` (a run with nothing to do)
- while it runs: `progress_line`, or `live_table` for jobs in parallel; both by `fitted` (width and colours)
- in the shell: `completion`, with `choices` for values that the command line does not list
"""
