"""The small network rebuilt for speed: the same answers, to a stated tolerance, with less work or in one kernel.

`layers` folds a fitted network, once, in float64. Three executions use the result: `lean`, PyTorch operations that a
compiler can fuse; `with_triton`, one kernel on a GPU that fetches the texture, too; `whole`, one kernel of all that a
codec computes, on the CPU or an NVIDIA GPU, whose networks `with_drjit` writes with their weights in the code.
"""
