"""Labelled trajectories and demonstrations on disk."""
