"""Effects: physical causes that a model can leave out, and a job can add by name."""
