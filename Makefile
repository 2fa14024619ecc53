# Each target calls course.py, which sets up what it needs. On Windows: python course.py lab
PYTHON ?= python3
ARGS ?=

.PHONY: help lab test course docs slides homework release versions setup clean

help:
	@echo "make lab      open the course in JupyterLab (ARGS='--port 9999' for its options)"
	@echo "make test     run lint, types, unit tests and every notebook"
	@echo "make course   execute the notebooks in order; pages to read in build/course"
	@echo "make docs     build the site in build/site and check it"
	@echo "make slides   slides from the notebooks in build/slides (ARGS='00 01' for some)"
	@echo "make homework student copies, and autograder versions in build/homework (SECRET_SEED=... for your own tests)"
	@echo "make release  build sdist, wheel and site, try them, and print the commands that publish"
	@echo "make versions unit tests with the oldest and newest dependencies (ARGS='oldest' for one)"
	@echo "make setup    only set up"
	@echo "make clean    remove the environment and all results"

lab test course docs slides homework release versions setup:
	@"$(PYTHON)" course.py $@ $(ARGS)

clean:
	rm -rf .venv build .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
