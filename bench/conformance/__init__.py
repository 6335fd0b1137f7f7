"""Tests of codecs that anyone can run: conformance, and behaviour at the extremes."""
