"""The scenes that ship with the suite, as text."""
