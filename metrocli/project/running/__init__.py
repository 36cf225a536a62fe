"""Who computes the jobs of a run, and what keeps runs apart.

`memo` answers a run that has nothing to do; `files` locks the project; `executor` computes jobs here, in other
processes, or by `cluster` on other computers. Results are always written by the process that was started.
"""
