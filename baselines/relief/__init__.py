"""The codec `relief`: finds the height of a surface in its training slices and marches it at decoding."""
