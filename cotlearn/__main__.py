"""Makes `python -m cotlearn` run the command `cotlearn`."""

from cotlearn.cli import main

main()
