"""Chapter 8: the microscope: noise, calibration, planes, coins and a watch gear."""
