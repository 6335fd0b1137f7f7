"""The codec `relief`: finds the height of a surface in its training slices and marches it at decoding.

A *height* is a picture (H, W): how far each texel's point lies above the plane, in widths of the picture. `sweep` finds
it, `geometry` follows rays to it, and `codec` fits latents and a network on it. docs/relief.md describes the method.
"""
