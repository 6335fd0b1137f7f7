"""What a scene asks of its material: which texels, at what size, seen and lit from where, and how much each counts."""
