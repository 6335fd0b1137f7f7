"""Computes the demand of a scene: which texels it shows, at what size, from which directions, with which weight."""

UNIFORM = 0.1  # share of the samples of a fit to a scene, or of the weights of its pairs, that is spread uniformly
