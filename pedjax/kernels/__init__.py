"""A step made into one kernel: unrolled to single numbers, and run over whole recordings on a GPU."""
