"""Smoothing while measurements arrive (docs/incremental.md)."""
