"""Recorded paths of scenarios as functions of time, with or without residuals, and the random numbers behind them."""
