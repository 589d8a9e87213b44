"""Pages that studies write: the comparison report, the fit, the extraction and the comparison of two studies."""
