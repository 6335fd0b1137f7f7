"""What records say of each other: two runs compared, codecs told apart, ranks, and rungs chosen within limits."""
