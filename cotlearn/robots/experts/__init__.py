"""Planned demonstrators, one folder a task, and how they are recorded."""
