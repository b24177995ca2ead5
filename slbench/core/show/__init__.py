"""How values show themselves: as text, as parts of a report, as figures."""
