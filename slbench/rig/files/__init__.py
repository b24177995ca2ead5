"""Calibrations of other programs, turned into the entries of our own file of a rig.

One file a format.  A format recognises its files by what is in them, never by their names, and
returns what they say as a :class:`~slbench.rig.files.base.Calibration`: two devices and the motion
between them, in the file's own convention of pixels and unit of length.
:func:`~slbench.rig.files.entries.rig_entries` makes entries of it, with what a person states beside
the file, and :func:`slbench.rig.opencv.read_rig` checks and builds the rig, whatever it came from.
:func:`~slbench.rig.files.writing.write_calibration` goes the other way.
"""
