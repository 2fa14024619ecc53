"""Planned demonstrators, one file a task."""
