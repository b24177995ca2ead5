"""Making data sets, on one machine or many."""
