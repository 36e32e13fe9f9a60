"""Arms, their limits, and the files that their controllers read."""
