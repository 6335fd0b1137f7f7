"""The commands of NeuBTF: what other codecs' files cannot do."""
