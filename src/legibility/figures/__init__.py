"""Pictures and films, drawn from motions and measurements."""
