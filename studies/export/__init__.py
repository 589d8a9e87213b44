"""The way from a design to an ECU: C code that was run in the loop that ranked it."""
