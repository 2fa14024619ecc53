"""Lets `python -m cotlearn` do what the command `cotlearn` does."""

from cotlearn.cli import main

main()
