"""The baseline codecs and reference codecs, one file each."""
