"""Which gain matters."""
