"""Designs and cases as the report shows them."""
