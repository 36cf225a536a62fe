"""python -m metrocli is the command metrocli."""

from metrocli.cli.main import main

main()
