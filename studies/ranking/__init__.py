"""Designs in order, and how much of that order is luck."""
