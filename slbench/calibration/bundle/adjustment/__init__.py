"""The bundle adjustment: its start, parameters and lens models, and what it leaves uncertain."""
