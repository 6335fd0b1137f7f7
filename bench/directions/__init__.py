"""Directions of the hemisphere: angles and sets of them, and interpolation between measured ones."""
