"""Curves from start to goal, the quality-diversity archive that covers them, and tracking."""
