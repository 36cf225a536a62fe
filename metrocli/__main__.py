"""Run the command line with `python -m metrocli`."""

from metrocli.cli.main import main

main()
