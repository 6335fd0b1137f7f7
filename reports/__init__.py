"""Records and stored artefacts → tables and figures. Computes nothing new."""
