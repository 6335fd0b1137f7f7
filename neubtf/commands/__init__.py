"""The commands of NeuBTF, for features that other codecs' files do not have."""
