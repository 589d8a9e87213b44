"""Data in the page for its script."""
