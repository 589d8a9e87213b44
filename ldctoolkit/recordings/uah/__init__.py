"""Trips of UAH-DriveSet as recordings."""
