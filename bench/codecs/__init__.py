"""What codecs are made of: their files, the registry that finds them, networks and their fitting."""
