"""The tables of designs: values, ranges, conditions, full grids and samples."""
