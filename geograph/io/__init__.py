"""Readers and writers of recordings and results."""
