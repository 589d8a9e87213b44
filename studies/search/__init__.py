"""Designs that are asked for instead of written down."""
