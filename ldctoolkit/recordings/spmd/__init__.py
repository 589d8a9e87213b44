"""Trips of the SPMD tables as recordings."""
