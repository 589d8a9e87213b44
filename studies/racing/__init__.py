"""Designs that are given up before they have run on all scenarios."""
