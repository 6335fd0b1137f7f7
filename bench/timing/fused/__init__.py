"""The small network rebuilt for speed: the same answers, to a stated tolerance, with less work or in one kernel.

`layers` folds what is known of a fitted network, once, in float64. Three executions read it: `lean`, PyTorch
operations that a compiler can fuse; `with_drjit`, one kernel on the CPU with the weights in its code; `with_triton`,
one kernel on a GPU. The kernels fetch the texture too; `whole` has all that a codec computes in the one of the CPU.
"""
