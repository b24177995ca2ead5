"""Reading data sets: samples, filters, splits, PyTorch."""
