"""Building blocks of codecs: their files, the registry, networks and fitting."""
