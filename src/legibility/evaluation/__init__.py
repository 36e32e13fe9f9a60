"""Measurements on held-out scenes."""
