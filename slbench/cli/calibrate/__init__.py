"""``slbench calibrate``: calibrate by one model of all pixels, and measure with it."""
