"""What is common to codecs: their files, the registry, encoding and loading."""
