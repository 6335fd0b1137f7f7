"""Opens materials (built in, measured or given as maps), and converts, thins and repairs them."""
