"""Six-dof lines."""
def simulated_lines(*a): raise NotImplementedError
