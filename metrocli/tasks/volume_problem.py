"""x"""


def faults(settings):
    return ()


def build(*a): ...
