"""What a data set is to be: its specification and the values drawn from it."""
