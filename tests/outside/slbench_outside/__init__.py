"""One of each kind that slbench lets others add."""
