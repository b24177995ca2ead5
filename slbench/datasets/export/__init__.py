"""Data sets in the layouts of others: pictures, arrays, masks, clouds, light transport."""
