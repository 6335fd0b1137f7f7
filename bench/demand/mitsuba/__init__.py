"""Mitsuba 3: its scenes, codec files as its surfaces, and a path tracer that bakes. Imports nothing by itself."""
