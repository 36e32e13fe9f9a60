"""Curves from start to goal and the quality-diversity archive that covers them."""
