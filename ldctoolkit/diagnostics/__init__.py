"""How well a fitted mixture describes the events it was fitted to: numbers and warnings, no plots."""
