"""The rivals and reference rows, one file a codec."""
