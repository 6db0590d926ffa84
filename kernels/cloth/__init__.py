"""Kernels of the cloth simulation.

State arrays have the shape [world_count, vertex_count]: worlds are independent copies of one garment that are
simulated side by side. Positions, forces and energies are float64, because float32 stalls before equilibrium; the
linear system is float32.
"""
