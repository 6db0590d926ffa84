"""Warp kernels: arrays in, arrays out. Nothing in here imports anything of ours outside this package."""
