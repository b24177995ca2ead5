"""Pattern sets compared on one scene."""
