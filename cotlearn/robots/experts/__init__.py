"""Planned demonstrators, one folder per task, and the recording of their demonstrations."""
