"""Generated departures against those that the scenario model was fitted to, and against the model itself."""
