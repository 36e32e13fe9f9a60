"""Rivals of the modulator: other policies, and search without learning."""
