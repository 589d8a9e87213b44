"""Figures of the report: plain functions of arrays that return a figure."""
