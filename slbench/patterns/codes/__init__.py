"""Codes of the literature beside fringes and Gray codes, one file a family."""
