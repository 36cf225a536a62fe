"""The command line: one file a command, which reads, calls `project`, and prints.

`main` -> `shell.idle` (nothing to do) -> `commands` (imports a command when it is used, reports failures) -> the
command -> `console` (stdout, stderr), `terminal` and `columns` (text), `summary` (--json).
"""
