"""Big text tables of many trips: where each trip lies, and its rows as numbers."""
