"""``slbench dataset``: data sets of many scans."""
