"""Lenses and panels: distortion, blur, shading, and what a panel emits."""
