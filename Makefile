# Each target calls course.py, which sets up what it needs. On Windows: python course.py lab
PYTHON ?= python3
ARGS ?=

.PHONY: help lab test check course docs slides homework release bridge setup lines clean

help:
	@echo "make lab      open the course in JupyterLab (ARGS='--port 9999' for its options)"
	@echo "make test     run lint, types, unit tests and every notebook (ARGS='tests/flows' for some)"
	@echo "make check    two minutes of these: this machine, some tests, one notebook"
	@echo "make course   execute the notebooks in order; pages to read in build/course (ARGS='00 02' for some)"
	@echo "make docs     check the spelling and build the site in build/site"
	@echo "make slides   slides from the notebooks in build/slides (ARGS='00 01' for some)"
	@echo "make homework student copies, and autograder versions in build/homework (5 min; SECRET_SEED=... for your own tests)"
	@echo "make release  build sdist, wheel and site, try them, and print the commands that publish"
	@echo "make bridge   run the tests and pages that need LeRobot, in an environment in build/bridge"
	@echo "make setup    only set up"
	@echo "make lines    count the lines of code of each folder"
	@echo "make clean    remove the environment and all results"

lab test check course docs slides homework release bridge setup:
	@"$(PYTHON)" course.py $@ $(ARGS)

lines:
	@"$(PYTHON)" tests/house/lines.py

clean:
	rm -rf .venv build docs/reference/api/modules .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
