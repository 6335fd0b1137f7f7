"""Opens materials: built in, measured or given as maps; converts, thins and repairs them."""
