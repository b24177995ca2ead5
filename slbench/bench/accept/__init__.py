"""Acceptance tests of optical 3-D scanners: artefacts in many places, errors against limits."""
