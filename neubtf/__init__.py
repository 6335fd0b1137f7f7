"""The NeuBTF method (Rodriguez-Pardo et al., "NeuBTF: Neural fields for BTF encoding and transfer", 2023)."""
