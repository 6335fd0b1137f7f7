"""The small network rebuilt for speed: the same answers, to a stated tolerance, with less work or in one kernel.

`layers` folds a fitted network, once, in float64. Three executions use the result: `lean`, PyTorch operations that a
compiler can fuse; `with_drjit`, one kernel on the CPU or an NVIDIA GPU, with the weights in its code; `with_triton`,
one kernel on a GPU. The kernels fetch the texture too; `whole` puts all that a codec computes into Dr.Jit's kernel.
"""
