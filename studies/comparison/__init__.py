"""Two studies on the scenarios that they share."""
