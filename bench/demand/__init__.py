"""What a scene asks of its material: which texels, at what size, seen and lit from where, and how much each counts."""

UNIFORM = 0.1  # of the samples of a fit to a scene, or of the weights of its pairs, are spread over everything alike
